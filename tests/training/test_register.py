from functools import partial

import cv2
import numpy as np
import pytest
import torch

from training import data, register
from training.validate import upright_sift

SIDE = 384
all_of_sift = partial(upright_sift, keypoints=20_000)


def scenery() -> np.ndarray:
    rng = np.random.default_rng(3)
    fine = cv2.resize(rng.integers(0, 255, (96, 96, 3)).astype(np.uint8), (SIDE, SIDE))
    coarse = cv2.resize(rng.integers(0, 255, (12, 12, 3)).astype(np.uint8), (SIDE, SIDE))
    return cv2.addWeighted(fine, 0.7, coarse, 0.3, 0)


def relief(v, u) -> np.ndarray:
    """A displacement of up to 6 px that changes over the image, (..., 2)."""
    return np.stack([6.0 * np.sin(u / 60.0), 4.0 * np.cos(v / 80.0)], axis=-1)


@pytest.fixture(scope="module")
def pair() -> data.Scene:
    a = scenery()
    v, u = np.indices((SIDE, SIDE)).astype(np.float32)
    moved = np.stack([u, v], axis=-1) - relief(v, u)  # b shows at p what a has at p - relief(p)
    b = cv2.remap(a, moved.astype(np.float32), None, cv2.INTER_CUBIC)
    H_b_a = np.diag([0.5, 0.5, 1.0])
    large = cv2.resize(a, None, fx=2.0, fy=2.0, interpolation=cv2.INTER_CUBIC)
    H_b_a[:2, 2] = -0.25  # half-pixel rule
    return data.scene("pair", "test", [large, b], H_i_0=[np.eye(3), H_b_a], name="test_a_b")


@pytest.fixture(scope="module")
def offsets(pair) -> np.ndarray:
    return register.register_again(pair, all_of_sift)


def test_the_displacement_is_found_to_a_pixel(offsets):
    v, u = np.indices(offsets.shape[:2]) * float(register.GRID_PX)
    apart = np.linalg.norm(offsets - relief(v, u), axis=2)
    inner = apart[8:-8, 8:-8]
    assert np.median(inner) < 0.5
    assert np.quantile(inner, 0.95) < 2.0


def test_a_registered_pair_lies_on_itself(pair, offsets, tmp_path):
    data.save_registration(tmp_path, pair, offsets)
    again = data.registered(pair, tmp_path)
    a, b = (p[30:-30, 30:-30].astype(float) for p in again.images)
    before = cv2.warpPerspective(pair.images[0], pair.H_i_0[1], (SIDE, SIDE))[30:-30, 30:-30]
    assert np.abs(a - b).mean() < 0.4 * np.abs(before - b).mean()
    assert again.label_noise == data.REGISTERED_NOISE
    np.testing.assert_array_equal(again.H_i_0[1], np.eye(3))


def test_a_registration_cut_off_while_it_is_written_leaves_no_file(
    pair, offsets, tmp_path, monkeypatch
):
    def cut_off(file, **_):
        file.write(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(np, "savez_compressed", cut_off)
    with pytest.raises(KeyboardInterrupt):
        data.save_registration(tmp_path, pair, offsets)
    assert data.registered(pair, tmp_path) is pair


def test_ground_that_one_image_lacks_stays_masked(pair, offsets, tmp_path):
    data.save_registration(tmp_path, pair, np.zeros_like(offsets))
    black = [pair.images[0].copy(), pair.images[1]]
    black[0][: 2 * 100] = 0
    cut = data.scene("pair", "test", black, H_i_0=pair.H_i_0, name=pair.name)
    mask = data.registered(cut, tmp_path).masks[0]
    assert mask[:90].max() == 0
    assert mask[120:].min() == 255


def test_a_pair_without_registration_stays_as_it_is(pair, tmp_path):
    assert data.registered(pair, tmp_path) is pair


def test_images_that_share_nothing_keep_their_label(pair):
    rng = np.random.default_rng(1)
    other = cv2.resize(rng.integers(0, 255, (80, 80, 3)).astype(np.uint8), (SIDE, SIDE))
    strangers = data.scene("pair", "test", [pair.images[1], other])
    assert register.register_again(strangers, all_of_sift) is None


def test_offsets_that_no_neighbour_shares_are_dropped():
    rng = np.random.default_rng(2)
    uv = rng.uniform(0, 300, (400, 2))
    offset = np.tile([5.0, -3.0], (400, 1)) + rng.normal(0, 0.3, (400, 2))
    wrong = rng.choice(400, 60, replace=False)
    offset[wrong] = rng.uniform(-20, 20, (60, 2))
    kept = register.confirmed(uv, offset)
    near = np.linalg.norm(offset - [5.0, -3.0], axis=1) < 3.0
    assert kept[near].all()
    assert kept[~near].sum() <= 3


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--data", "nowhere"], "no data folder"),
        (["--weights", "nowhere.ckpt"], "no checkpoint at nowhere.ckpt"),
        (["--weights", "list.ckpt"], "list.ckpt is not a whole checkpoint"),
        (["--weights", "bare.ckpt"], "bare.ckpt is not a whole checkpoint"),
        (["--out", "in_the_way"], "in_the_way"),
        (["--out", "out"], "data holds no pairs"),
        (["--data", "damaged"], r"pairs\.json is not a whole listing"),
        (["--data", "unreadable"], r"no readable picture at .*0\.png"),
    ],
)
def test_what_is_missing_is_one_line(arguments, said, tmp_path, monkeypatch):
    (tmp_path / "data/train").mkdir(parents=True)
    (tmp_path / "damaged/train").mkdir(parents=True)
    (tmp_path / "damaged/pairs.json").write_text("[{")
    (tmp_path / "unreadable/train/drone/a").mkdir(parents=True)
    (tmp_path / "unreadable/train/drone/a/0.png").write_bytes(b"no picture")
    (tmp_path / "in_the_way").write_text("a file")
    torch.save([1, 2], tmp_path / "list.ckpt")
    torch.save({"config": {}, "average": {}}, tmp_path / "bare.ckpt")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit, match=said) as stop:
        register.main(["--data", "data", *arguments])
    assert "\n" not in str(stop.value.code)
