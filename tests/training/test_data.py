import cv2
import numpy as np
import pytest

from training import data

FOLDER = data.data_folder()
needs_data = pytest.mark.skipif(FOLDER is None, reason="no data folder (VWNAV_DATA)")


def test_a_sure_phase_correlation_corrects_the_registration():
    entry = {"H": np.eye(3).tolist(), "pc_shift_b_minus_a": [3.0, -1.0], "pc_response": 0.5}
    np.testing.assert_allclose(data.registration(entry)[:2, 2], [3.0, -1.0])


@pytest.mark.parametrize(("shift", "trusted"), [([1.0, 1.0], True), ([20.0, 3.0], False)])
def test_an_unsure_one_decides_only_whether_to_use_the_pair(shift, trusted):
    entry = {"H": np.eye(3).tolist(), "pc_shift_b_minus_a": shift, "pc_response": 0.1}
    assert (data.registration(entry) is not None) == trusted


def test_pairs_that_are_far_off_are_left_out():
    assert data.registration({"H": np.eye(3).tolist(), "res": [-203.3, 29.9]}) is None


def test_black_corners_are_no_ground_but_dark_roofs_are():
    picture = np.full((100, 100, 3), 120, np.uint8)
    picture[:40, :40] = 0
    picture[70:74, 70:74] = 0
    mask = data.ground_mask(picture)
    assert mask[10, 10] == 0
    assert mask[72, 72] == 255
    assert mask[90, 10] == 255


def test_generated_pairs_are_found_and_lone_pictures_are_not(tmp_path):
    picture = np.full((64, 64, 3), 100, np.uint8)
    for name in ("0_a.jpg", "0_b.jpg", "1_a.jpg"):
        cv2.imwrite(str(tmp_path / name), picture)
    scenes = list(data.site_pairs(tmp_path))
    assert [len(s.pictures) for s in scenes] == [2]


def test_a_picture_that_cannot_be_read_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"gone\.jpg"):
        data.read(tmp_path / "gone.jpg")


def test_without_data_there_is_nothing_to_train_on(tmp_path):
    assert data.load_scenes(None, tmp_path) == ([], [])


@needs_data
def test_only_training_pictures_are_ever_read(monkeypatch):
    seen = []
    monkeypatch.setattr(
        data, "read", lambda path: seen.append(path) or np.zeros((9, 9, 3), np.uint8)
    )
    data.load_scenes(FOLDER, FOLDER / "nowhere")
    assert len(seen) > 1000
    assert all(path.relative_to(FOLDER).parts[0] == "train" for path in seen)
