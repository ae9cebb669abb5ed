"""Weak places of several images joined: what is found, and what must never be."""

import math
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vwnav.estimation.beginning.sequences import Carried, Sequences, ShownGround, begun
from vwnav.estimation.beginning.way import WayCounted, WayPose
from vwnav.geometry.geodesy import LocalFrame
from vwnav.geometry.rotations import quat_from_rotation, rotation_from_euler, wrap_pi
from vwnav.types import Attitude, MapFix, OdometryMotion, Rejected, RejectReason, WeakFix

HOME = LocalFrame(47.0, 8.0, 400.0)
SEEN_M, AGL_M, NEEDED = 100.0, 70.0, 6.6
MAP_M = 800.0
SIGMA_M, SIGMA_YAW_RAD = 1.0, 0.01
SEEDS = st.integers(0, 2**32 - 1)


def place(north_m, east_m, yaw_rad, agl_m=AGL_M, decades=2.0, needed=NEEDED) -> WeakFix:
    lat_deg, lon_deg, _ = HOME.to_geodetic(np.array([north_m, east_m, 0.0]))
    fix = MapFix(
        t_s=0.0,
        lat_deg=float(lat_deg),
        lon_deg=float(lon_deg),
        covariance_ne_m2=SIGMA_M**2 * np.eye(2),
        yaw_rad=yaw_rad,
        sigma_yaw_rad=SIGMA_YAW_RAD,
        agl_m=agl_m,
        sigma_agl_m=0.01 * agl_m,
        point="nadir",
        features="learned",
    )
    return WeakFix(fix, decades, needed, SEEN_M)


def anywhere(rng: np.random.Generator) -> WeakFix:
    """A wrong place, with as much evidence as chance gives at times."""
    north_m, east_m = rng.uniform(-MAP_M / 2, MAP_M / 2, 2)
    decades = min(1.0 + rng.exponential(0.6), NEEDED - 0.1)
    agl_m = AGL_M * math.exp(rng.normal(0.0, 0.1))
    return place(north_m, east_m, rng.uniform(-math.pi, math.pi), agl_m, decades)


@dataclass
class Flight:
    """A straight way over the map, as the truth has it and as odometry does.

    Attributes:
        step_m: between images.
        turned_rad, stretched: of the odometry's axes against the map's, and of its unit.
        loses: images that odometry does not reach.
    """

    rng: np.random.Generator
    step_m: float = 60.0
    turned_rad: float = 1.0
    stretched: float = 1.4
    loses: frozenset[int] = frozenset()
    sequences: Sequences = field(default_factory=lambda: Sequences(HOME))
    number: int = 0

    def __post_init__(self) -> None:
        self.heading_rad = float(self.rng.uniform(-math.pi, math.pi))
        self.place_ne_m = self.rng.uniform(-100.0, 100.0, 2)
        self._follow(None)

    def fly(self) -> None:
        way = self.step_m * np.array([math.cos(self.heading_rad), math.sin(self.heading_rad)])
        self.place_ne_m = self.place_ne_m + way
        self.number += 1
        self._follow(None if self.number in self.loses else way)

    def _follow(self, way) -> None:
        t_s, yaw_rad = float(self.number), self.heading_rad + self.turned_rad
        attitude = Attitude(t_s, quat_from_rotation(rotation_from_euler(0.0, 0.0, yaw_rad)))
        if way is None:
            self.sequences.follow(Rejected(t_s, RejectReason.FEW_KEYPOINTS), attitude)
            return
        c, s = math.cos(self.turned_rad), math.sin(self.turned_rad)
        seen = self.stretched * np.array([[c, -s], [s, c]]) @ way
        seen = seen * (1.0 + self.rng.normal(0.0, 0.01, 2))
        motion = OdometryMotion(
            t0_s=t_s - 1.0,
            t1_s=t_s,
            displacement_ned_m=np.array([*seen, 0.0]),
            covariance_ned_m2=0.2**2 * np.eye(3),
            yaw_increment_rad=0.0,
            sigma_yaw_rad=0.003,
            agl_m=self.stretched * AGL_M,
            tracks=80,
        )
        self.sequences.follow(motion, attitude)

    def right(self, decades=2.0, off_ne_m=(0.0, 0.0)) -> WeakFix:
        off_m = self.rng.normal(0.0, SIGMA_M, 2) + off_ne_m
        yaw_rad = wrap_pi(self.heading_rad + self.rng.normal(0.0, SIGMA_YAW_RAD))
        return place(*(self.place_ne_m + off_m), yaw_rad, decades=decades)

    def join(self, *weak: WeakFix) -> MapFix | None:
        image = Rejected(float(self.number), RejectReason.FEW_INLIERS, weak=weak)
        outcome = self.sequences.join(image)
        return outcome if isinstance(outcome, MapFix) else None

    def off_m(self, fix: MapFix) -> float:
        there = HOME.to_ned(fix.lat_deg, fix.lon_deg, 400.0)[:2]
        return float(np.linalg.norm(there - self.place_ne_m))


def flown(flight: Flight, images: int, see) -> list[MapFix]:
    """The fixes of so many images; `see` says what each shows."""
    fixes = []
    for _ in range(images):
        flight.fly()
        fix = flight.join(*see())
        if fix is not None:
            assert flight.off_m(fix) <= 5.0 * fix.sigma_m, (flight.off_m(fix), fix.sigma_m)
            fixes.append(fix)
    return fixes


@given(SEEDS, st.floats(-math.pi, math.pi), st.floats(0.3, 3.0))
@settings(max_examples=60, deadline=None)
def test_a_right_sequence_is_found_among_wrong_places(seed, turned_rad, stretched):
    rng = np.random.default_rng(seed)
    flight = Flight(rng, turned_rad=turned_rad, stretched=stretched)
    fixes = flown(flight, 10, lambda: (anywhere(rng), flight.right(), anywhere(rng)))
    assert fixes
    assert fixes[-1].placed_by == "sequence"
    assert abs(wrap_pi(fixes[-1].yaw_rad - flight.heading_rad)) < 0.1
    assert fixes[-1].agl_m == pytest.approx(AGL_M, rel=0.1)


def test_places_that_have_nothing_to_do_with_each_other_are_never_a_fix():
    """600 flights of 15 images, each with three wrong places."""
    for seed in range(600):
        rng = np.random.default_rng(seed)
        flight = Flight(rng)
        for _ in range(15):
            flight.fly()
            assert flight.join(*(anywhere(rng) for _ in range(3))) is None, seed


def test_a_road_that_looks_alike_all_along_is_no_place():
    """Every image is found somewhere along the way that is flown, heading right, and surely."""
    for seed in range(200):
        rng = np.random.default_rng(seed)
        flight = Flight(rng)
        ahead = np.array([math.cos(flight.heading_rad), math.sin(flight.heading_rad)])
        for _ in range(10):
            flight.fly()
            off_ne_m = rng.uniform(-MAP_M / 4, MAP_M / 4) * ahead
            assert flight.join(flight.right(decades=6.0, off_ne_m=off_ne_m)) is None, seed


@given(SEEDS, st.floats(30.0, 300.0))
@settings(max_examples=30, deadline=None)
def test_two_ways_that_fit_alike_are_ambiguous(seed, apart_m):
    """Rows of houses: what is found is found one row further as well."""
    rng = np.random.default_rng(seed)
    flight = Flight(rng)
    assert not flown(flight, 12, lambda: (flight.right(), flight.right(off_ne_m=(apart_m, 0.0))))


@given(SEEDS)
@settings(max_examples=30, deadline=None)
def test_where_odometry_is_lost_nothing_is_joined(seed):
    flight = Flight(np.random.default_rng(seed), loses=frozenset(range(0, 20, 2)))
    assert not flown(flight, 20, lambda: (flight.right(),))


@given(SEEDS, st.floats(0.0, 4.0))
@settings(max_examples=30, deadline=None)
def test_the_same_ground_again_and_again_is_no_evidence(seed, step_m):
    flight = Flight(np.random.default_rng(seed), step_m=step_m)
    assert not flown(flight, 12, lambda: (flight.right(decades=4.0),))


def test_what_is_carried_too_far_is_dropped():
    flight = Flight(np.random.default_rng(0), step_m=60.0)
    flown(flight, 2, lambda: (flight.right(decades=3.0),))
    flown(flight, 25, tuple)
    assert not flown(flight, 1, lambda: (flight.right(decades=3.0),))


def pose(rng: np.random.Generator, t_s: float, before: WayPose | None = None) -> WayPose:
    known = before or WayPose(t_s=0.0, way=0, place=np.zeros(2), agl=1.0, yaw_rad=0.3)
    return replace(
        known,
        t_s=t_s,
        place=known.place + rng.normal(0.0, 1.0, 2),
        agl=known.agl * math.exp(rng.normal(0.0, 0.1)),
        yaw_rad=known.yaw_rad + rng.normal(0.0, 0.3),
        variance=known.variance + 1e-4,
        yaw_variance=known.yaw_variance + 1e-5,
    )


@given(SEEDS)
@settings(max_examples=50, deadline=None)
def test_carried_in_two_steps_it_comes_to_the_same_place_as_in_one(seed):
    rng = np.random.default_rng(seed)
    first = pose(rng, 0.0)
    second = pose(rng, 1.0, first)
    third = pose(rng, 2.0, second)
    start = begun(place(10.0, -20.0, 2.0), first, HOME)
    twice, once = start.to(second).to(third), start.to(third)
    assert twice.pose == pytest.approx(once.pose, abs=1e-9)
    assert np.linalg.eigvalsh(twice.covariance).min() > 0.0


@given(SEEDS)
@settings(max_examples=30, deadline=None)
def test_what_errs_alike_is_not_more_certain_together(seed):
    """Two images that share all of their error: joined they are as unsure as one."""
    rng = np.random.default_rng(seed)
    one = begun(place(*rng.normal(0.0, 50.0, 2), 1.0), pose(rng, 0.0), HOME)
    assert one.joined(one).covariance == pytest.approx(one.covariance)


@given(st.floats(-150.0, 150.0), st.floats(-150.0, 150.0), st.floats(20.0, 200.0))
def test_overlap_is_a_share_whichever_is_asked(north_m, east_m, side_m):
    one, other = ShownGround(0.0, 0.0, 100.0, 1.0), ShownGround(north_m, east_m, side_m, 1.0)
    assert 0.0 <= one.overlap(other) <= 1.0
    assert one.overlap(other) == pytest.approx(other.overlap(one))


def test_evidence_of_new_ground_adds_up_and_of_old_ground_does_not():
    one = begun(place(0.0, 0.0, 0.0), pose(np.random.default_rng(0), 0.0), HOME)

    def beside(east_m: float, decades: float) -> Carried:
        return replace(one, ground=(ShownGround(0.0, east_m, SEEN_M, decades),))

    assert begun(place(0.0, 0.0, 0.0, decades=6.0), one.at, HOME).decades == pytest.approx(2.2)
    assert one.joined(beside(100.0, 3.0)).decades == pytest.approx(one.decades + 3.0 + 0.5)
    assert one.joined(beside(60.0, 3.0)).decades == pytest.approx(one.decades + 0.6 * 3.5)
    assert one.joined(beside(10.0, 3.0)).decades == pytest.approx(3.0)
    assert one.joined(beside(10.0, 1.0)).decades == pytest.approx(one.decades)


def motion(t0_s: float, t1_s: float, north_m: float, down_m: float = 0.0) -> OdometryMotion:
    return OdometryMotion(
        t0_s=t0_s,
        t1_s=t1_s,
        displacement_ned_m=np.array([north_m, 0.0, down_m]),
        covariance_ned_m2=np.eye(3),
        yaw_increment_rad=0.1,
        sigma_yaw_rad=0.01,
        agl_m=10.0,
        tracks=80,
    )


def test_a_way_adds_up_its_keyframes_in_heights():
    way = WayCounted()
    way.follow(Rejected(0.0, RejectReason.NOT_TRIED), 0.0)
    way.follow(motion(0.0, 1.0, 5.0, down_m=-10.0), 0.1)  # climbs to twice the height
    way.follow(motion(0.0, 2.0, 10.0, down_m=-10.0), 0.2)
    pose = way.follow(motion(2.0, 3.0, 5.0), 0.3)
    assert pose.place == pytest.approx([2.0, 0.0])
    assert (pose.agl, pose.yaw_rad, pose.way) == (2.0, 0.3, 0)
    assert pose.variance == pytest.approx(0.01 + 0.04)


def test_an_image_that_is_not_reached_begins_another_way_unless_the_keyframe_still_stands():
    way = WayCounted()
    way.follow(motion(0.0, 1.0, 5.0), 0.1)
    assert way.follow(Rejected(2.0, RejectReason.FEW_MATCHES), 0.1).way == 1
    again = way.follow(motion(0.0, 3.0, 5.0), 0.1)
    assert (again.way, again.place[0]) == (0, 0.5)
    assert way.follow(motion(7.0, 8.0, 5.0), 0.1).way != 0
