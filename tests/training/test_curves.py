import pytest

from training import curves

LOG = "step,elapsed_s,matching,agreement,matched,inliers\n"


def test_curves_are_read_where_the_log_has_them(tmp_path):
    log = tmp_path / "log.csv"
    log.write_text(LOG + "50,60.0,2.5,1.0,0.1\n100,120.0,,,,31.5\n")
    assert curves.read_curve(log, "matching") == curves.Curve([1.0], [2.5])
    assert curves.read_curve(log, "inliers") == curves.Curve([2.0], [31.5])


def test_a_long_curve_is_smoothed_without_moving_it():
    line = curves.Curve([float(i) for i in range(40)], [2.0 * i for i in range(40)])
    smooth = curves.smoothed(line)
    assert len(smooth.values) == 40 // curves.SMOOTH
    assert smooth.values == pytest.approx([2.0 * m for m in smooth.minutes])


def test_the_image_is_drawn_for_two_runs(tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "log.csv").write_text(LOG + "50,60.0,2.5,1.0,0.1\n100,120.0,,,,31.5\n")
    curves.draw([tmp_path / "a", tmp_path / "b"], tmp_path / "deep/curves.png")
    assert (tmp_path / "deep/curves.png").stat().st_size > 10_000


def test_a_folder_without_a_log_is_one_line(tmp_path):
    with pytest.raises(SystemExit, match=r"no log\.csv"):
        curves.draw([tmp_path], tmp_path / "curves.png")


@pytest.mark.parametrize(
    "log", [b"\x89PNG\r\n\x1a\n", b"step,matching\n1,2\n", LOG.encode() + b"1,a,2\n"]
)
def test_what_is_no_log_is_one_line(log, tmp_path):
    (tmp_path / "log.csv").write_bytes(log)
    with pytest.raises(SystemExit, match="is no log of a run") as stop:
        curves.main([str(tmp_path), "-o", str(tmp_path / "curves.png")])
    assert "\n" not in str(stop.value.code)


@pytest.mark.parametrize("output", ["curves.xyz", ".", "log.csv/curves.png"])
def test_where_nothing_can_be_drawn_is_one_line(output, tmp_path):
    (tmp_path / "log.csv").write_text(LOG + "50,60.0,2.5,1.0,0.1\n")
    with pytest.raises(SystemExit) as stop:
        curves.main([str(tmp_path), "-o", str(tmp_path / output)])
    assert str(stop.value.code).count("\n") == 0
    assert [path.name for path in tmp_path.iterdir()] == ["log.csv"]
