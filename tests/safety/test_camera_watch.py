"""Images of another size, and one image again and again."""

import math
from dataclasses import replace

import numpy as np
import pytest

from vwnav.safety.camera_watch import CameraWatch
from vwnav.safety.readiness import check_camera
from vwnav.types import Frame


def seen(seed: int, shape=(48, 64)) -> Frame:
    image = np.random.default_rng(seed).integers(0, 255, shape, dtype=np.uint8)
    return Frame(index=0, t_s=float(seed), image=image)


def at(t_s: float, frame: Frame) -> Frame:
    return replace(frame, t_s=t_s)


def test_images_that_differ_are_good_and_their_time_is_kept():
    watch = CameraWatch(64, 48)
    assert watch.image_s is None
    assert [watch.look(seen(seed), seed + 0.04) for seed in range(3)] == ["", "", ""]
    assert watch.image_s == 2.04
    assert watch.trouble == ""


def test_another_mode_of_the_same_size_is_trouble_until_it_is_the_calibrated_one():
    troubles = iter(["another mode", ""])
    watch = CameraWatch(64, 48, lambda: next(troubles))
    assert watch.look(seen(1), 1.0) == "another mode"
    assert check_camera(watch.sight, 1.0).detail == "another mode"
    assert check_camera(watch.sight, 1.0).verdict == "FAIL"
    assert watch.look(seen(2), 2.0) == ""


def test_one_image_again_is_trouble_until_another_comes():
    watch = CameraWatch(64, 48)
    watch.look(seen(1), 1.0)
    assert "repeats" in watch.look(at(1.1, seen(1)), 1.1)
    assert "repeats" in watch.trouble
    assert watch.look(seen(2), 2.0) == ""
    assert watch.trouble == ""


def test_an_image_of_one_shade_may_come_again():
    watch = CameraWatch(64, 48)
    dark = Frame(index=0, t_s=0.0, image=np.zeros((48, 64), dtype=np.uint8))
    assert [watch.look(dark, 0.0), watch.look(at(0.1, dark), 0.1)] == ["", ""]


@pytest.mark.parametrize("shape", [(64, 48), (48, 63), (47, 64)])
def test_another_size_is_not_what_was_calibrated(shape):
    trouble = CameraWatch(64, 48).look(seen(1, shape), 1.0)
    assert "pictures of 64 x 48 px" in trouble
    assert f"are {shape[1]} x {shape[0]} px" in trouble


def test_a_change_anywhere_on_its_grid_is_seen():
    watch = CameraWatch(64, 48)
    first = seen(1)
    changed = first.image.copy()
    changed[32, 48] ^= 1
    watch.look(first, 1.0)
    assert watch.look(Frame(index=0, t_s=2.0, image=changed), 2.0) == ""


def test_the_buffer_of_the_camera_may_be_used_again():
    watch = CameraWatch(64, 48)
    frame = seen(1)
    watch.look(frame, 1.0)
    frame.image[:] = seen(2).image
    assert watch.look(at(1.1, frame), 1.1) == ""


@pytest.mark.parametrize("off_s", [math.nan, math.inf, -math.inf, 3600.0, -3600.0, 0.2, -2.5])
def test_a_time_that_cannot_be_is_trouble_and_the_next_right_one_is_good(off_s):
    watch = CameraWatch(64, 48)
    assert watch.look(at(10.0, seen(1)), 10.0) == ""
    assert "not of now" in watch.look(at(10.1 + off_s, seen(2)), 10.1)
    assert watch.image_s == 10.1
    assert watch.look(at(10.2, seen(3)), 10.25) == ""


@pytest.mark.parametrize("again_s", [10.0, 9.5])
def test_times_must_rise(again_s):
    watch = CameraWatch(64, 48)
    watch.look(at(10.0, seen(1)), 10.0)
    assert "do not rise" in watch.look(at(again_s, seen(2)), 10.1)
    assert watch.look(at(10.01, seen(3)), 10.2) == ""


@pytest.mark.parametrize(
    ("level", "spoilt", "shade"),
    [(0, 0, "black"), (5, 0, "black"), (6, 0, ""), (249, 0, ""), (250, 0, "white"),
     (0, 1, ""), (255, 1, "")],
)  # fmt: skip
def test_an_image_of_nothing_but_black_or_white_is_told(level, spoilt, shade):
    image = np.full((48, 64), level, np.uint8)
    image[: 16 * spoilt, :] = 128
    watch = CameraWatch(64, 48)
    assert watch.look(Frame(index=0, t_s=0.0, image=image), 0.0) == ""
    assert watch.sight.shade == shade


def test_the_rate_is_that_of_the_newest_exposures():
    watch = CameraWatch(64, 48)
    for number in range(7):
        watch.look(at(0.2 * number, seen(number)), 0.2 * number)
    assert watch.sight.rate_hz is None
    watch.look(at(1.4, seen(7)), 1.4)
    assert watch.sight.rate_hz == pytest.approx(5.0)
    for number in range(1, 17):
        watch.look(at(1.4 + 0.05 * number, seen(7 + number)), 1.4 + 0.05 * number)
    assert watch.sight.rate_hz == pytest.approx(20.0)
    assert (watch.sight.image_s, watch.sight.trouble) == (watch.image_s, "")
