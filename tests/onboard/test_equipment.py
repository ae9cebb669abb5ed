"""What `vwnav fly` does before the flight."""

from types import SimpleNamespace

import numpy as np
import pytest

from vwnav.config import Config
from vwnav.geometry.camera import Camera
from vwnav.onboard.equipment import hold_exposure, is_same_link
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
