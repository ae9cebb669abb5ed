"""What `vwnav fly` does before the flight."""

from contextlib import ExitStack
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from vwnav.config import Config
from vwnav.geometry.camera import Camera
from vwnav.geometry.sensor_mode import SensorMode
from vwnav.onboard import equipment
from vwnav.onboard.equipment import hold_exposure, is_same_link
from vwnav.types import Frame
from vwnav.vehicle import Navigation


@pytest.mark.parametrize(
    ("truth", "same"),
    [
        ("udpin:0.0.0.0:14540", True),
        ("udp://:14540", True),
        ("udpin://127.0.0.1:14560", False),
        ("tcpout:127.0.0.1:14540", False),
        ("nonsense", False),
    ],
)
def test_truth_on_the_autopilots_own_port_is_noticed(truth, same):
    assert is_same_link(truth, "udpin://0.0.0.0:14540") is same


WHOLE = SensorMode(read_px=(1640, 1232), seen_px=(0, 0, 3280, 2464))


@pytest.mark.parametrize(
    ("given", "fits"),
    [
        (WHOLE, True),
        (SensorMode(read_px=(1640, 1232), seen_px=(2, 2, 3276, 2460)), True),  # rounded
        (SensorMode(read_px=(1920, 1080), seen_px=(680, 692, 1920, 1080)), False),
        (SensorMode(read_px=(1640, 1232), seen_px=(0, 310, 3280, 1844)), False),
        (SensorMode(pixels="MJPG"), True),  # tells nothing that is calibrated
        (None, True),
    ],
)
@pytest.mark.parametrize(("offset_s", "flown_m"), [(0.0, None), (0.05, None), (0.05, 60.0)])
def test_images_of_another_mode_are_not_flown_on(monkeypatch, given, fits, offset_s, flown_m):
    frame = Frame(0.0, np.zeros((480, 640), np.uint8), 0)
    source = SimpleNamespace(next_frame=lambda: frame, close=lambda: None, sensor_mode=given)
    asked = []
    monkeypatch.setattr(
        equipment, "open_source", lambda *words, **names: asked.append(names) or source
    )
    camera = replace(Camera.from_hfov(640, 480, 70.0), sensor_mode=WHOLE, time_offset_s=offset_s)
    plan, options = SimpleNamespace(camera=camera), SimpleNamespace(video="picamera2")
    with ExitStack() as stack:
        opened = equipment.open_camera(options, plan, None, None, lambda: 0.0, stack, flown_m)
        trouble = equipment.watch_camera(opened, camera).look(opened.next_frame(), offset_s)
    assert asked == [{"mode": WHOLE, "at_once": flown_m is None}]
    assert (trouble == "") is fits
    assert fits or "in another mode than its calibration" in trouble


class LiveSource:
    """A live source that remembers how it was asked to hold its exposure."""

    def hold_exposure(self, most_s, say) -> None:
        self.most_s, self.say = most_s, say


def test_before_an_estimate_the_exposure_is_held_for_the_cruise_over_the_lowest_waypoint():
    source, said, config = LiveSource(), [], Config()
    plan = SimpleNamespace(
        camera=Camera.from_hfov(640, 480, 78.0),
        config=config,
        route_ned_m=np.array([[0.0, 0.0, -50.0], [90.0, 0.0, -25.0]]),
    )
    hold_exposure(source, plan, lambda: Navigation(None), said.append)
    px_s = plan.camera.K[0, 0] * config.limits.cruise_m_s / 25.0
    assert source.most_s() == pytest.approx(1.5 / px_s)
    source.say("a line")
    assert said == ["a line"]
    hold_exposure(SimpleNamespace(), plan, lambda: Navigation(None), said.append)  # a file
