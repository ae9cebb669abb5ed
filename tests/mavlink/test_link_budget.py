"""What a serial link carries: worked out, asked for, and kept to."""

from itertools import pairwise

import pytest
from autopilot_links import COPTER, PX4, Bench
from hypothesis import given
from hypothesis import strategies as st

from vwnav.errors import LinkError
from vwnav.mavlink.link_budget import bytes_per_s, plan_link
from vwnav.mavlink.modes import AutopilotKind
from vwnav.types import Attitude
from vwnav.vehicle import VelocitySetpoint

KINDS = st.sampled_from(AutopilotKind)


def rates_hz(budget):
    return {stream.name: stream.rate_hz for stream in budget.streams}


def test_only_a_serial_port_is_narrow():
    assert bytes_per_s("serial:///dev/ttyAMA0:57600") == 5760.0
    assert bytes_per_s("udpin://0.0.0.0:14540") is None
    with pytest.raises(LinkError):
        bytes_per_s("serial:///dev/ttyAMA0")


@pytest.mark.parametrize("kind", AutopilotKind)
def test_a_wide_link_carries_all_that_is_wanted(kind):
    budget = plan_link(kind, None)
    assert budget.refusal is None
    assert budget.estimate_hz == 50.0
    assert rates_hz(budget)["ATTITUDE"] == rates_hz(budget)["HIGHRES_IMU"] == 50.0
    assert rates_hz(plan_link(kind, 92160.0)) == rates_hz(budget)


@given(KINDS, st.floats(100.0, 1e5))
def test_what_is_asked_for_fits_or_the_link_is_refused(kind, capacity_bytes_s):
    budget = plan_link(kind, capacity_bytes_s)
    down = sum(s.bytes_per_s for s in budget.streams if s.instead_of is None)
    if budget.refusal is None:
        assert down <= 0.8 * capacity_bytes_s
        assert budget.estimate_hz * 129 <= 0.8 * capacity_bytes_s
        assert budget.estimate_hz >= 10.0
        assert rates_hz(budget)["ATTITUDE"] >= 20.0
    else:
        assert "\n" not in budget.refusal
        assert capacity_bytes_s < 5760.0


@given(KINDS, st.floats(100.0, 1e5), st.floats(1.0, 3.0))
def test_more_room_never_means_fewer_estimates_or_a_refusal(kind, capacity_bytes_s, times):
    less, more = plan_link(kind, capacity_bytes_s), plan_link(kind, times * capacity_bytes_s)
    assert more.estimate_hz >= less.estimate_hz
    assert not (more.refusal and not less.refusal)


@pytest.mark.parametrize("kind", [PX4, COPTER])
def test_57600_baud_fly_without_a_queue(kind):
    """Ten seconds as in flight: nothing waits in either direction, whatever it sent unasked."""
    bench = Bench(kind, baud=57600.0, settle_s=10.0)
    bench.has_origin()
    bench.run(5.0)
    assert bench.autopilot.link_refusal is None
    bench.autopilot.take_measurements()
    bench.peer.heard.clear()
    ages_s, queues_s = [], []
    for i in range(500):
        bench.autopilot.send_estimate(bench.estimate())
        if i % 2 == 0:
            bench.autopilot.send_velocity(VelocitySetpoint(1.0, 0.0, 0.0))
        bench.run(0.02)
        taken = bench.autopilot.take_measurements()
        ages_s += [bench.clock() - each.t_s for each in taken if isinstance(each, Attitude)]
        queues_s += [bench.up.free_s - bench.clock(), bench.down.free_s - bench.clock()]
    assert max(queues_s) < 0.1
    assert len(ages_s) >= 200
    assert max(ages_s) < 0.15
    sent_s = [t_s for t_s, m in bench.peer.heard if m.get_type() == "VISION_POSITION_ESTIMATE"]
    assert len(sent_s) >= 100
    assert max(b - a for a, b in pairwise(sent_s)) < 0.2


def test_a_link_that_is_too_narrow_is_refused_in_one_line():
    bench = Bench(baud=19200.0, settle_s=1.0)
    assert "19200 baud does not carry" in bench.autopilot.link_refusal


def test_an_attitude_that_comes_too_seldom_is_refused_whatever_the_baud_rate():
    """PX4 limits a port by itself (MAV_1_RATE)."""
    bench = Bench(baud=115200.0, settle_s=5.0)
    assert bench.autopilot.link_refusal is None
    bench.peer.rate_hz = lambda number: 10.0
    bench.run(5.0)
    assert "times a second on this link, 20 are needed" in bench.autopilot.link_refusal
