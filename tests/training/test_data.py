import json
from collections import Counter

import cv2
import numpy as np
import pytest

from training import data, landmarks, warps

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
    image = np.full((100, 100, 3), 120, np.uint8)
    image[:40, :40] = 0
    image[70:74, 70:74] = 0
    mask = data.ground_mask(image)
    assert mask[10, 10] == 0
    assert mask[72, 72] == 255
    assert mask[90, 10] == 255


def test_generated_pairs_are_found_and_lone_images_are_not(tmp_path):
    image = np.full((64, 64, 3), 100, np.uint8)
    for name in ("0_a.jpg", "0_b.jpg", "1_a.jpg"):
        cv2.imwrite(str(tmp_path / name), image)
    scenes = list(data.site_pairs(tmp_path))
    assert [len(s.images) for s in scenes] == [2]


def test_an_image_that_cannot_be_read_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"gone\.jpg"):
        data.read(tmp_path / "gone.jpg")


def test_without_data_there_is_nothing_to_train_on(tmp_path):
    assert data.load_scenes(None, tmp_path, tmp_path) == ([], [])


@needs_data
def test_only_training_images_are_ever_read(monkeypatch):
    seen = []
    monkeypatch.setattr(
        data, "read", lambda path: seen.append(path) or np.zeros((9, 9, 3), np.uint8)
    )
    data.load_scenes(FOLDER, FOLDER / "nowhere", FOLDER / "nowhere")
    assert len(seen) > 1000
    assert all(path.relative_to(FOLDER).parts[0] == "train" for path in seen)


def test_overlapping_frames_are_registered_to_a_pixel():
    scenery = np.random.default_rng(0).integers(0, 255, (120, 160, 3)).astype(np.uint8)
    scenery = cv2.resize(scenery, (1280, 960), interpolation=cv2.INTER_CUBIC)
    frames = [scenery[:700, :900], scenery[200:900, 150:1050]]
    H_b_a = landmarks.register(*map(landmarks.landmarks, frames))
    corners = np.array([[200.0, 250.0], [850.0, 650.0]])
    np.testing.assert_allclose(warps.warp_points(H_b_a, corners), corners - [150, 200], atol=0.5)


def test_frames_that_share_nothing_are_not_registered():
    rng = np.random.default_rng(1)
    frames = [
        cv2.resize(rng.integers(0, 255, (60, 80, 3)).astype(np.uint8), (640, 480)) for _ in range(2)
    ]
    assert landmarks.register(*map(landmarks.landmarks, frames)) is None


def test_frames_of_different_flights_are_no_neighbours():
    image = np.zeros((50, 50, 3), np.uint8)
    frames = [data.scene("drone", source, [image]) for source in ("a", "b")]
    assert list(data.overlapping(frames)) == []


@needs_data
def test_open_terms_leave_only_open_sources(monkeypatch):
    monkeypatch.setattr(data, "read", lambda path: np.zeros((9, 9, 3), np.uint8))
    training, kept = data.load_scenes(FOLDER, FOLDER / "nowhere", FOLDER / "nowhere", "open")
    assert {s.source for s in training} <= data.OPEN_SOURCES
    assert len(training) > 100
    assert len(kept) > 10


def entry(source, stem):
    return {"src": source, "a": f"train/pair/{source}/{stem}.jpg"}


@pytest.mark.parametrize(
    ("source", "stem", "place"),
    [
        ("stanford_drone", "hyang_v0", "stanford_drone hyang"),
        ("quake_tr", "adiyaman_merkez_1_0_920_a", "quake_tr adiyaman"),
        ("cd_LEVIR", "test_7_a", "levir test_7"),
        ("cd_levir256", "test_7_0256_0512_a", "levir test_7"),
        ("sztaki", "Szada_3_a", "sztaki Szada"),
        ("sztaki", "SZTAKI_AirChange_Benchmark_Archieve_a", "sztaki Szada"),
        ("neon_sjer", "SJER_002_a", "neon_sjer SJER_002"),
        ("srif_whu", "12_a", "srif_whu 12"),
    ],
)
def test_pairs_that_share_ground_are_one_place(source, stem, place):
    assert data.place_of(entry(source, stem)) == place


@needs_data
def test_validation_shows_no_place_that_training_shows(monkeypatch):
    monkeypatch.setattr(data, "read", lambda path: np.zeros((9, 9, 3), np.uint8))
    training, kept = data.load_scenes(FOLDER, FOLDER / "nowhere", FOLDER / "nowhere")
    assert {s.place for s in kept} & {s.place for s in training} == set()
    assert {s.source for s in kept} >= {"srif_whu", "stanford_drone", "quake_tr"}
    assert not any(s.source == "odm_tuniu" for s in training)


@needs_data
def test_a_place_with_many_pairs_counts_no_more_than_one_with_few(monkeypatch):
    monkeypatch.setattr(data, "read", lambda path: np.zeros((9, 9, 3), np.uint8))
    drawn = Counter()
    for pair in data.real_pairs(FOLDER):
        drawn[pair.place] += pair.weight
    campus = {place: w for place, w in drawn.items() if place.startswith("stanford")}
    assert len(campus) == 6
    assert max(campus.values()) <= data.MOST_OF_A_PLACE["stanford_drone"] + 1e-6


def weak_folder(tmp_path):
    image = np.random.default_rng(0).integers(50, 200, (40, 40, 3)).astype(np.uint8)
    for letter in "ab":
        cv2.imwrite(str(tmp_path / f"x_{letter}.png"), image)
    pair = {
        "src": "drawn",
        "split": "train",
        "a": "x_a.png",
        "b": "x_b.png",
        "H": np.eye(3).tolist(),
    }
    (tmp_path / data.WEAK_PAIRS).write_text(json.dumps([pair]))
    return tmp_path


def test_weak_pairs_are_used_only_once_they_are_registered_again(tmp_path):
    folder, registrations = weak_folder(tmp_path), tmp_path / "registered"
    assert data.labelled_pairs(folder, registrations) == []
    registrations.mkdir()
    (pair,) = data.real_pairs(folder, listing=data.WEAK_PAIRS)
    data.save_registration(registrations, pair, np.zeros((10, 10, 2), np.float32))
    assert [p.label_noise for p in data.labelled_pairs(folder, registrations)] == [
        data.REGISTERED_NOISE
    ]
