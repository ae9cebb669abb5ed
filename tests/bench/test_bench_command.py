import json
import sys

import cv2
import numpy as np
import pytest
from bench_scenes import ground

from vwnav.__main__ import main
from vwnav.bench.features import methods, pair_scenes
from vwnav.bench.features import run as features
from vwnav.errors import ConfigError

SCORE = {
    "scenes", "keypoints", "matches", "inliers", "precision", "reprojection_px", "repeatability",
    "repeated_above_chance",
    "auc", "located_near", "located_far", "place_error",
}  # fmt: skip
TIMES = {
    "extract_ms", "extract_cpu_ms", "match_ms", "match_cpu_ms", "extract_cpu_to_sift",
    "extract_cpu_to_xfeat",
}  # fmt: skip
THESIS = {"points_per_image", "extract_ms", "matched_per_image", "match_ms", "match_ratio"}


@pytest.fixture
def data(tmp_path):
    """A data folder with one registered pair and one drone image."""
    folder = tmp_path / "data"
    (folder / "eval" / "pair" / "drawn").mkdir(parents=True)
    (folder / "eval" / "drone" / "flight").mkdir(parents=True)
    for name in "ab":
        cv2.imwrite(str(folder / "eval" / "pair" / "drawn" / f"1_{name}.jpg"), ground(500, 500))
    cv2.imwrite(str(folder / "eval" / "drone" / "flight" / "1.jpg"), ground(500, 700, seed=1))
    path = "eval/pair/drawn/1_{}.jpg"
    entry = {"split": "eval", "src": "drawn", "a": path.format("a"), "b": path.format("b")}
    (folder / "pairs.json").write_text(json.dumps([entry | {"H": np.eye(3).tolist()}]))
    return folder


@pytest.fixture
def bench(monkeypatch):
    """Runs `vwnav bench features`; XFeat has a test of its own."""

    def absent():
        raise ConfigError("xfeat is left out")

    monkeypatch.setattr(methods, "load_xfeat", absent)
    monkeypatch.delenv("VWNAV_DATA", raising=False)

    def run(*arguments: object) -> None:
        argv = ["vwnav", "bench", "features", "--views", "1", "--repeats", "1", *arguments]
        monkeypatch.setattr(sys, "argv", [str(a) for a in argv])
        main()

    return run


def test_json_is_one_object_that_says_everything(bench, data, capsys):
    with pytest.raises(SystemExit) as done:
        bench("--data", data, "--json")
    assert not done.value.code
    report = json.loads(capsys.readouterr().out)
    assert set(report) == {"protocol", "networks", "groups", "timing", "thesis", "skipped"}
    assert set(report["groups"]) == {"drawn", "keioSFC", "all"}
    assert report["groups"]["drawn"]["unit"] == "px"
    scores = report["groups"]["drawn"]["methods"]
    assert set(scores["sift"]) == SCORE
    assert scores["vwnav_default"]["located_near"] == 1.0
    assert set(report["timing"]) == {"320x320", "640x480"}
    assert set(report["timing"]["640x480"]["orb"]) == TIMES
    assert set(report["thesis"]["sift"]) == THESIS
    assert report["networks"]["vwnav_default"]["parameters"] > 100_000
    assert "xfeat is left out" in report["skipped"]


def test_a_person_gets_tables_and_a_folder_with_plot_and_images(bench, data, tmp_path, capsys):
    with pytest.raises(SystemExit) as done:
        bench("--data", data, "-o", tmp_path / "out")
    assert not done.value.code
    printed = capsys.readouterr()
    assert "drawn: 1 scenes" in printed.out
    assert "Thesis tables 6.1 and 6.2" in printed.out
    assert "no flights/islamabad" in printed.err
    written = {str(p.relative_to(tmp_path / "out")) for p in (tmp_path / "out").rglob("*.*")}
    assert {"report.json", "features.png", "matches/drawn_sift.jpg"} <= written


def test_a_folder_without_data_is_one_line_and_exit_1(bench, tmp_path, capsys):
    with pytest.raises(SystemExit) as done:
        bench("--data", tmp_path)
    assert done.value.code == 1
    error = capsys.readouterr().err.strip()
    assert "--data" in error
    assert error.count("\n") == 0


def test_a_folder_that_cannot_be_made_is_one_line_before_anything_runs(
    bench, data, tmp_path, capsys
):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(SystemExit) as done:
        bench("--data", data, "-o", tmp_path / "file")
    assert done.value.code == 1
    printed = capsys.readouterr()
    assert "cannot make" in printed.err
    assert printed.err.strip().count("\n") == 0
    assert printed.out == ""


def test_without_any_folder_generated_places_are_judged_on(monkeypatch, tmp_path):
    monkeypatch.delenv("VWNAV_DATA", raising=False)
    monkeypatch.setattr(features.vwnav, "__file__", str(tmp_path / "a" / "vwnav" / "__init__.py"))
    monkeypatch.setattr(pair_scenes, "GENERATED_SITES", 1)
    assert features.data_folder(None) is None
    skipped: list[str] = []
    ((name, scenes),) = features._groups(None, 1, skipped)
    assert (name, len(scenes)) == ("generated", 1)
    assert "generated places only" in skipped[0]
