"""`vwnav bench localizer` and `vwnav bench significance`, through the real command."""

import json
import shutil
import sys

import cv2
import numpy as np
import pytest
from bench_scenes import ground
from scipy import stats

from vwnav.__main__ import main
from vwnav.bench.localizer import boards, repeating, short_flights, unrelated
from vwnav.bench.localizer.board_map import open_board
from vwnav.bench.localizer.labels import UNCONFIRMED_PX, corrected
from vwnav.bench.localizer.looks import CAMERA, LookCase, TruePose
from vwnav.bench.localizer.repeating import repeating_boards
from vwnav.bench.localizer.scoring import judge, score, upper_bound
from vwnav.errors import ModelError
from vwnav.types import MapFix, Prior, Rejected, RejectReason
from vwnav.vision.features.learned import (
    CAUTIOUS_LOG10_PER_DECADE,
    LearnedFeatures,
    released_model,
)
from vwnav.vision.features.load import load_features
from vwnav.vision.localizer import Localizer

EVERYWHERE = np.ones((500, 500), np.bool_)


@pytest.fixture
def data(tmp_path):
    """A data folder with one registered pair, and images of two other places."""
    folder = tmp_path / "data"
    places = {"train/pair/cd_LEVIR/1_a": 0, "train/pair/cd_LEVIR/1_b": 0}
    places |= {"train/single/fields/1": 1, "train/drone/flight/1": 2}
    for name, seed in places.items():
        path = folder / f"{name}.jpg"
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), ground(500, 500, seed))
    path = "train/pair/cd_LEVIR/1_{}.jpg"
    entry = {"split": "train", "src": "cd_LEVIR", "a": path.format("a"), "b": path.format("b")}
    (folder / "pairs.json").write_text(json.dumps([entry | {"H": np.eye(3).tolist()}]))
    return folder


@pytest.fixture
def bench(monkeypatch):
    """Runs a command under `vwnav bench`; gives its exit code."""
    monkeypatch.delenv("VWNAV_DATA", raising=False)
    monkeypatch.setattr(boards, "LOOKS_AN_IMAGE", 1)
    monkeypatch.setattr(repeating, "LOOKS_AN_IMAGE", 1)
    monkeypatch.setattr(unrelated, "IMAGES", 3)

    def run(*arguments: object) -> int:
        monkeypatch.setattr(sys, "argv", ["vwnav", "bench", *map(str, arguments)])
        with pytest.raises(SystemExit) as done:
            main()
        return int(done.value.code or 0)

    return run


def test_a_place_is_found_on_its_map_and_on_no_other(bench, data, tmp_path, capsys):
    output = tmp_path / "out"
    arguments = ("--data", data, "--features", "sift", "--looks", 1, "--json", "-o", output)
    assert bench("localizer", *arguments) == 0
    report = json.loads(capsys.readouterr().out)
    found = {row["kind"]: row["features"]["sift"] for row in report["scores"]}
    assert set(found) == {"prior", "search", "wrong", "wrong_search"}
    assert found["prior"]["located"] == found["search"]["located"] == 1.0
    assert found["prior"]["error_95"] < 1.0
    assert found["wrong"]["false"] == found["wrong_search"]["false"] == 0
    assert sum(found["wrong"]["rejected"].values()) == 1
    assert json.loads((output / "localizer.json").read_text()) == report


def test_drawn_ground_needs_no_data_and_a_person_gets_tables(bench, capsys):
    arguments = ("--set", "repeats", "--only", "houses", "--features", "orb", "--looks", 1)
    assert bench("localizer", *arguments) == 0
    assert "houses: the right place, a rough prior" in capsys.readouterr().out


def test_short_flights_over_sand_are_scored_alone_and_joined(bench, capsys, monkeypatch):
    monkeypatch.setattr(short_flights, "KINDS", {})
    monkeypatch.setattr(short_flights, "IMAGES", 3)
    arguments = ("--set", "repeats", "--only", "sequences", "--features", "sift", "--looks", 1)
    assert bench("localizer", *arguments, "--json") == 0
    report = json.loads(capsys.readouterr().out)
    rows = {row["kind"]: row for row in report["scores"]["sift"]}
    assert set(rows) == {"prior", "search", "wrong", "wrong_search"}
    assert all(row["flights"] == 1 and row["joined"] >= row["alone"] for row in rows.values())
    assert report["false"]["sift"] == []


def test_short_flights_of_the_judging_set_are_told_where_to_look(bench, capsys):
    assert bench("localizer", "--set", "judge", "--only", "sequences", "--features", "sift") == 1
    assert "bench features --sequence" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["localizer", "significance"])
@pytest.mark.parametrize(
    ("listed", "said"),
    [
        (None, "--data"),
        ("[{", "no list of registered pairs"),
        ('[{"split": "train", "src": "sztaki"}]', "no list of registered pairs"),
    ],
)
def test_a_folder_without_good_pairs_is_one_line_and_exit_1(
    bench, data, capsys, command, listed, said
):
    (data / "pairs.json").unlink()
    if listed is not None:
        (data / "pairs.json").write_text(listed)
    assert bench(command, "--data", data, "--features", "sift") == 1
    error = capsys.readouterr().err.strip()
    assert said in error
    assert error.count("\n") == 0


def test_an_image_that_is_none_is_one_line_and_exit_1(bench, data, capsys):
    (data / "train/pair/cd_LEVIR/1_a.jpg").write_bytes(b"not a picture")
    assert bench("localizer", "--data", data, "--features", "sift", "--looks", 1) == 1
    error = capsys.readouterr().err.strip()
    assert "1_a.jpg" in error
    assert error.count("\n") == 0


def test_a_group_that_is_not_there_is_one_line_and_exit_1(bench, data, capsys):
    arguments = ("--data", data, "--features", "sift", "--looks", 1, "--only", "moon")
    assert bench("localizer", *arguments) == 1
    assert "no group 'moon'" in capsys.readouterr().err


def test_a_set_that_is_not_there_is_a_usage_error(bench):
    assert bench("localizer", "--set", "moon") == 2


def test_what_was_measured_of_a_model_is_put_into_its_file(bench, data, tmp_path, capsys):
    model = tmp_path / "new.onnx"
    shutil.copy(released_model("nano"), model)
    arguments = ("--data", data, "--features", model, "--looks", 100, "--write", "--json")
    assert bench("significance", *arguments) == 0
    (found,) = json.loads(capsys.readouterr().out).values()
    assert found["looks"] > 0
    assert LearnedFeatures(model).log10_per_decade == found["log10_per_decade"] >= 1.0
    assert (
        LearnedFeatures(model).feature_set_id
        == LearnedFeatures(released_model("nano")).feature_set_id
    )


@pytest.mark.parametrize("said", ["", "0", "nan", "five"])
def test_a_model_without_a_value_is_trusted_least_and_a_wrong_value_is_refused(tmp_path, said):
    onnx = pytest.importorskip("onnx")
    graph, model = tmp_path / "model.onnx", onnx.load(released_model("nano"))
    kept = [each for each in model.metadata_props if each.key != "log10_per_decade"]
    del model.metadata_props[:]
    model.metadata_props.extend(kept)
    if said:
        model.metadata_props.add(key="log10_per_decade", value=said)
    onnx.save(model, graph)
    if said:
        with pytest.raises(ModelError, match="vwnav bench significance"):
            LearnedFeatures(graph)
    else:
        assert LearnedFeatures(graph).log10_per_decade == CAUTIOUS_LOG10_PER_DECADE


@pytest.mark.parametrize(
    ("log10_1", "log10_01", "expected"),
    [
        (-9.7, -14.9, 5.7),  # the line through both meets five decades at -25.3
        (-8.0, -8.5, 4.6),  # two decades of 1 %
        (-0.3, -0.9, 1.1),
    ],
)
def test_the_tail_of_unrelated_looks_makes_the_value(log10_1, log10_01, expected):
    assert unrelated.per_decade(log10_1, log10_01) == expected


def test_a_label_that_is_off_is_corrected_and_says_how_well_it_is_known():
    gray = cv2.cvtColor(ground(500, 500), cv2.COLOR_BGR2GRAY)
    off = np.array([[1.0, 0.0, 7.0], [0.0, 1.0, -5.0], [0.0, 0.0, 1.0]])
    H, sigma_px = corrected(gray, EVERYWHERE, gray, EVERYWHERE, off)
    assert pytest.approx(np.eye(3), abs=0.3) == H
    assert sigma_px < 0.5


def test_a_label_between_unrelated_images_stays_and_is_not_trusted():
    a, b = (cv2.cvtColor(ground(500, 500, seed), cv2.COLOR_BGR2GRAY) for seed in (0, 1))
    H, sigma_px = corrected(a, EVERYWHERE, b, EVERYWHERE, np.eye(3))
    assert np.array_equal(H, np.eye(3))
    assert sigma_px == UNCONFIRMED_PX


def look(kind="prior", truth=True) -> LookCase:
    return LookCase(
        group="drawn",
        name="one",
        kind=kind,
        image=np.zeros((480, 640), np.uint8),
        camera=CAMERA,
        prior=Prior(),
        seed=0,
        truth=TruePose(47.0, 8.0, 0.0, 50.0) if truth else None,
        unit_m=0.2,
        label_m=0.1,
    )


def fix(north_m: float, sigma_m: float, yaw_rad: float = 0.0) -> MapFix:
    covariance_m2 = sigma_m**2 * np.eye(2)
    return MapFix(
        0.0,
        47.0 + north_m / 111_170.0,
        8.0,
        covariance_m2,
        yaw_rad,
        0.01,
        50.0,
        1.0,
        "nadir",
        "orb",
    )


@pytest.mark.parametrize(
    ("said", "located", "false"),
    [
        (fix(1.0, 0.2), True, False),
        (fix(20.0, 0.2), False, True),
        (fix(20.0, 15.0), False, False),  # an ellipse that holds the truth misleads nobody
        (fix(1.0, 0.2, np.pi), False, True),  # the right place, turned
        (Rejected(0.0, RejectReason.AMBIGUOUS), False, False),
    ],
)
def test_a_fix_is_right_or_wide_or_false(said, located, false):
    outcome = judge(look(), said, 0.1)
    assert (outcome.located, outcome.false) == (located, false)


def test_every_fix_at_a_place_that_the_map_does_not_show_is_false():
    outcome = judge(look("wrong", truth=False), fix(0.0, 50.0), 0.1)
    assert outcome.false
    assert score([outcome]).located is None


def test_the_label_s_own_error_counts_in_the_ellipse():
    assert judge(look(), fix(0.3, 1e-6), 0.1).nees == pytest.approx(9.0, rel=0.01)


@pytest.mark.parametrize(("seen", "of"), [(0, 3000), (0, 10), (2, 50), (50, 50)])
def test_the_upper_bound_is_that_of_clopper_and_pearson(seen, of):
    expected = stats.beta.ppf(0.95, seen + 1, of - seen) if seen < of else 1.0
    assert upper_bound(seen, of) == pytest.approx(expected, abs=1e-6)


def test_a_runway_turned_by_180_degrees_looks_nearly_the_same():
    day = repeating._day("runway", repeating.KINDS["runway"], 0, 0, repeating.TEXTURE).astype(float)
    assert np.corrcoef(day.ravel(), day[::-1, ::-1].ravel())[0, 1] > 0.5
    assert np.array_equal(
        day, repeating._day("runway", repeating.KINDS["runway"], 0, 0, repeating.TEXTURE)
    )


def test_a_part_of_a_runway_is_not_believed_where_the_whole_tells_the_place(tmp_path):
    """Looked at thriftily it is found 200 m along the runway, with 28 inliers."""
    learned = load_features("learned")
    (board,) = (b for b in repeating_boards(8, "runway") if b.looks[0].name.startswith("runway 1."))
    (look,) = (each for each in board.looks if (each.name, each.kind) == ("runway 1.3", "prior"))
    with open_board(board, learned, str(tmp_path)) as pack:
        said = Localizer(pack, learned, look.camera).localize(look.frame(), look.prior, look.seed)
    assert judge(look, said, 0.0).located
