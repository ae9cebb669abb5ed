"""How high the aircraft travels home, and on after somebody else has had it."""

from dataclasses import replace

import numpy as np
import pytest
from test_flight import Scene, in_phase

from vwnav.mission.home import straight_home_ned_m
from vwnav.mission.mission import Mission, Phase
from vwnav.safety.safety_config import SafetyConfig
from vwnav.vehicle import FlightMode, Order

LOW_END = np.array([[60, 0, -50], [200, 0, -50], [200, 30, -4], [200, 60, -4.0]])
SLACK_M = 2.1  # a height is reached within 2 m
HIGH = SafetyConfig().return_height_m - SLACK_M


def low_at_the_end() -> Scene:
    scene = Scene(mission=Mission(LOW_END, home_ne_m=np.zeros(2)))
    return scene.run(lambda s: s.vehicle.position[2] > -4.5 and s.vehicle.position[1] > 50.0)


def lowest_on_the_way_m(scene: Scene, phase: Phase, out_of_m: float = 5.0) -> float:
    """Of the heights that are flown in a phase, farther than that from where it begins and home."""
    begin, heights = scene.vehicle.position[:2].copy(), []

    def seen(scene: Scene) -> bool:
        place = scene.vehicle.position
        off_m = min(np.hypot(*place[:2]), np.hypot(*(place[:2] - begin)))
        if scene.flight.phase is phase and off_m > out_of_m:
            heights.append(-place[2])
        return False

    scene.run(seen)
    return min(heights)


def test_a_return_from_low_down_climbs_before_it_goes_home():
    scene = low_at_the_end()
    scene.vehicle.be(battery_ratio=0.2)
    scene.run(in_phase(Phase.RETURN))
    assert lowest_on_the_way_m(scene, Phase.RETURN, 12.0) > HIGH  # it has to brake
    assert np.hypot(*scene.vehicle.position[:2]) < 2.0


def test_a_return_that_begins_in_fast_flight_climbs_where_it_comes_to_stand():
    low = np.array([[60.0, 0.0, -50.0], [80.0, 0.0, -6.0], [400.0, 0.0, -6.0]])
    scene = Scene(mission=Mission(low, home_ne_m=np.zeros(2)))
    scene.run(lambda s: s.vehicle.position[0] > 200.0)
    assert scene.vehicle.velocity[0] > 7.0
    scene.vehicle.be(battery_ratio=0.2)
    scene.run(in_phase(Phase.RETURN))
    turned_m = scene.vehicle.position[0]
    back = []
    scene.run(lambda s: back.append(s.vehicle.position.copy()) or s.vehicle.position[0] < 150.0)
    assert all(-place[2] > HIGH for place in back if place[0] < turned_m)


def test_the_last_leg_of_a_route_that_ends_low_is_flown_as_high():
    scene = low_at_the_end().run(lambda s: s.vehicle.velocity[0] < -1.0)
    assert scene.flight.phase is Phase.ROUTE
    assert -scene.vehicle.position[2] > HIGH
    assert lowest_on_the_way_m(scene, Phase.ROUTE) > HIGH
    assert scene.flight.end.reason is None


def test_a_return_that_is_high_already_stays_so_and_none_goes_above_the_ceiling():
    here, home = np.array([100.0, 0.0, -50.0]), np.zeros(2)
    assert straight_home_ned_m(here, home, 15.0).tolist() == [[0.0, 0.0, -50.0]]
    low = replace(SafetyConfig(), ceiling_m=12.0, return_height_m=40.0).way_home_m
    way = straight_home_ned_m(np.array([100.0, 0.0, -4.0]), home, low)
    assert way.tolist() == [[100.0, 0.0, -12.0], [0.0, 0.0, -12.0]]


@pytest.mark.parametrize("off_route_m", [0.0, 40.0])
def test_an_aircraft_that_is_given_back_low_climbs_to_its_leg_before_it_goes_on(off_route_m):
    route = np.array([[60.0, 0.0, -50.0], [400.0, 0.0, -50.0]])
    scene = Scene(mission=Mission(route, home_ne_m=np.zeros(2)))
    scene.run(lambda s: s.vehicle.position[0] > 120.0)
    scene.vehicle.be(mode=FlightMode.MANUAL)
    scene.go_on(1.0)
    scene.vehicle.position[:] = [150.0, off_route_m, -6.0]
    scene.vehicle.velocity *= 0.0
    scene.flight.obey(Order.GO_ON)
    scene.run(in_phase(Phase.ROUTE))
    assert lowest_on_the_way_m(scene, Phase.ROUTE, 2.0) > 45.0
    assert scene.flight.end.reason is None


def test_a_climb_to_its_leg_that_a_pilot_ends_is_not_gone_on_with_where_it_began():
    route = np.array([[60.0, 0.0, -50.0], [400.0, 0.0, -50.0]])
    scene = Scene(mission=Mission(route, home_ne_m=np.zeros(2)))
    scene.run(lambda s: s.vehicle.position[0] > 120.0)
    for north_m in (150.0, 190.0):  # given back low, taken again while it climbs, carried on
        scene.vehicle.be(mode=FlightMode.MANUAL)
        scene.go_on(1.0)
        scene.vehicle.position[:] = [north_m, 0.0, -6.0]
        scene.vehicle.velocity *= 0.0
        scene.flight.obey(Order.GO_ON)
        scene.run(in_phase(Phase.ROUTE)).go_on(1.0)
    scene.run(lambda s: s.vehicle.position[2] < -45.0)
    assert np.hypot(*(scene.vehicle.position[:2] - [190.0, 0.0])) < 1.0
