"""Simulated sensor streams: a multirotor in gusty wind, and what its sensors say, with latencies.

No pictures are drawn: fixes and odometry come from their error models.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from vwnav.estimation.ekf import Ekf, EkfConfig, NedFix, Start
from vwnav.geometry.rotations import quat_from_rotation, rotation_from_euler, rotation_from_vector
from vwnav.types import Array, Attitude, Estimate, OdometryMotion

G = 9.80665
DT = 0.01


@dataclass(frozen=True, kw_only=True)
class World:
    """What the flight is like; sigmas are drawn once a flight unless they are noises."""

    seconds: float = 120.0
    agl_m: float = 50.0
    speed_m_s: float = 9.0
    leg_s: float = 20.0
    wind_m_s: float = 5.0
    gust_m_s: float = 1.5
    tilt_bias_deg: float = 0.7
    tilt_drift_deg: float = 0.5
    tilt_noise_deg: float = 0.03
    yaw_bias_deg: float = 3.0
    yaw_step_deg: float = 0.0  # of the compass, at yaw_step_s
    yaw_step_s: float = 1e9
    baro_drift_m: float = 3.0
    fix_hz: float = 2.5
    fix_sigma_m: float = 0.6
    fix_latency_s: tuple[float, float] = (0.1, 0.3)
    wrong_share: float = 0.0
    odometry_hz: float = 15.0
    odometry_sigma: float = 0.0009  # of the AGL, as rendered flights measure it
    tilt_in_odometry: float = 0.1  # 0: the picture itself tells tilting from moving
    terrain_m: float = 0.0  # amplitude of hills of 400 m
    turn_deg_s: float = 60.0


@dataclass
class Truth:
    """At 100 Hz."""

    t_s: Array
    position_ned_m: Array
    velocity_ned_m_s: Array
    yaw_rad: Array
    agl_m: Array
    R_ned_body: list[Array]

    def index(self, t_s: float) -> int:
        return min(round(t_s / DT), len(self.t_s) - 1)


@dataclass
class Stream:
    """What comes in: (arrival time, callable on a filter)."""

    truth: Truth
    tilt_rad: Array | None = None  # slow error at 100 Hz
    events: list = field(default_factory=list)

    def sorted(self) -> list:
        return sorted(self.events, key=lambda event: event[0])


def _terrain(position_ned_m: Array, world: World) -> float:
    return world.terrain_m * (1.0 - math.cos(2.0 * math.pi * position_ned_m[0] / 400.0)) / 2.0


def fly(world: World, rng: np.random.Generator) -> Truth:
    """Climb straight up for 10 s, then legs of changing course at cruise speed."""
    n = int(world.seconds / DT)
    p, v, a_cmd = np.zeros(3), np.zeros(3), np.zeros(3)
    wind_dir = rng.uniform(0, 2 * math.pi)
    wind = world.wind_m_s * np.array([math.cos(wind_dir), math.sin(wind_dir), 0.0])
    gust = np.zeros(3)
    yaw = rng.uniform(-3, 3)
    course, climb_s = yaw, 10.0
    out = Truth(np.arange(n) * DT, np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n), np.zeros(n), [])
    for i in range(n):
        t = i * DT
        if t > climb_s and (t - climb_s) % world.leg_s < DT:
            course += math.radians(rng.uniform(60, 180)) * rng.choice([-1, 1])
        moving = t > climb_s + 5.0
        target = world.speed_m_s * moving * np.array([math.cos(course), math.sin(course), 0.0])
        height_error = (-world.agl_m if t > 0.5 else 0.0) - p[2]
        target[2] = np.clip(height_error, -world.agl_m / 8.0, 2.0)
        drag = -0.3 * (v - wind - gust)
        wanted = np.clip(1.5 * (target - v), -3.0, 3.0) - drag
        a_cmd += DT / 0.2 * (wanted - a_cmd)
        turn = (course - yaw + math.pi) % (2 * math.pi) - math.pi
        limit = math.radians(world.turn_deg_s) * DT
        yaw += float(np.clip(turn, -limit, limit))
        out.position_ned_m[i], out.velocity_ned_m_s[i], out.yaw_rad[i] = p, v, yaw
        out.agl_m[i] = -p[2] - _terrain(p, world)
        out.R_ned_body.append(_attitude(a_cmd, yaw))
        gust += DT * (-gust / 3.0) + world.gust_m_s * math.sqrt(2 * DT / 3.0) * rng.normal(
            size=3
        ) * [1, 1, 0.2]
        p, v = p + DT * v, v + DT * (a_cmd + drag)
    return out


def _attitude(thrust_m_s2: Array, yaw: float) -> Array:
    """Attitude whose thrust gives this horizontal acceleration."""
    c, s = math.cos(yaw), math.sin(yaw)
    forward = c * thrust_m_s2[0] + s * thrust_m_s2[1]
    right = -s * thrust_m_s2[0] + c * thrust_m_s2[1]
    pitch = -math.atan2(forward, G)
    roll = math.atan2(right * math.cos(pitch), G)
    return rotation_from_euler(roll, pitch, yaw)


def make(world: World, rng: np.random.Generator, truth: Truth | None = None) -> Stream:
    """The streams of one flight."""
    truth = truth or fly(world, rng)
    stream = Stream(truth)
    errors = _AttitudeErrors(world, rng, truth)
    stream.tilt_rad = errors.slow
    for i in range(0, len(truth.t_s), 2):
        stream.events.append(
            (truth.t_s[i] + 0.01, "attitude", Attitude(truth.t_s[i], errors.quat(i)))
        )
    _add_heights(stream, world, rng)
    _add_odometry(stream, world, rng, errors)
    _add_fixes(stream, world, rng, errors)
    return stream


class _AttitudeErrors:
    def __init__(self, world: World, rng: np.random.Generator, truth: Truth) -> None:
        n = len(truth.t_s)
        bias = rng.normal(size=2) * math.radians(world.tilt_bias_deg)
        walk = np.zeros((n, 2))
        keep = math.exp(-DT / 20.0)
        drive = (
            math.radians(world.tilt_drift_deg) * math.sqrt(1 - keep**2) * rng.normal(size=(n, 2))
        )
        for i in range(1, n):
            walk[i] = keep * walk[i - 1] + drive[i]
        self.slow = bias + walk  # about the body's level forward and right axes
        white = math.radians(world.tilt_noise_deg) * rng.normal(size=(n, 2))
        # Correlated over some 20 ms, as a filter's output is.
        self.white = (white + np.roll(white, 1, 0) + np.roll(white, 2, 0)) / math.sqrt(3)
        yaw = math.radians(world.yaw_bias_deg) * rng.normal() + np.cumsum(
            math.radians(0.05) * math.sqrt(DT) * rng.normal(size=n)
        )
        self.yaw = yaw + math.radians(world.yaw_step_deg) * (truth.t_s >= world.yaw_step_s)
        self.truth = truth

    def tilt_ne(self, i: int) -> Array:
        c, s = math.cos(self.truth.yaw_rad[i]), math.sin(self.truth.yaw_rad[i])
        f, r = self.slow[i] + self.white[i]
        return np.array([c * f - s * r, s * f + c * r])

    def quat(self, i: int) -> Array:
        tilt = rotation_from_vector([*self.tilt_ne(i), 0.0])
        turn = rotation_from_vector([0.0, 0.0, self.yaw[i]])
        return quat_from_rotation(turn @ tilt @ self.truth.R_ned_body[i])

    def heading_in_map(self, i: int) -> float:
        """What a localizer finds: the attitude's heading, turned as the map shows."""
        R = rotation_from_vector([*self.tilt_ne(i), 0.0]) @ self.truth.R_ned_body[i]
        return math.atan2(R[1, 0], R[0, 0])

    def nadir_shift(self, i: int) -> Array:
        """Of the ground point that seems to be below, per AGL."""
        n, e = self.tilt_ne(i)
        return np.array([-e, n])


def _add_heights(stream: Stream, world: World, rng: np.random.Generator) -> None:
    truth = stream.truth
    drift = world.baro_drift_m * rng.choice([-1, 1])
    for i in range(0, len(truth.t_s), 10):
        t = truth.t_s[i]
        height = -truth.position_ned_m[i, 2] + drift * t / truth.t_s[-1] + 0.2 * rng.normal()
        stream.events.append((t + 0.03, "height", (t, height)))


def _add_odometry(
    stream: Stream, world: World, rng: np.random.Generator, errors: _AttitudeErrors
) -> None:
    truth = stream.truth
    step = round(1.0 / world.odometry_hz / DT)
    key, key_noise, key_yaw_noise = None, np.zeros(3), 0.0
    sigma = world.odometry_sigma * np.array([0.7, 0.7, 0.4])  # keyframe's and picture's alike
    for i in range(0, len(truth.t_s), step):
        agl = truth.agl_m[i]
        if agl < 1.5:
            key = None
            continue
        if key is not None:
            way = (truth.position_ned_m[i] - truth.position_ned_m[key]) / truth.agl_m[key]
            shift = errors.nadir_shift(i) - errors.nadir_shift(key)
            noise = sigma * rng.normal(size=3) + key_noise
            tilt = rotation_from_vector([*errors.tilt_ne(key), 0.0])
            turn = rotation_from_vector([0.0, 0.0, errors.yaw[key]])
            seen = turn @ tilt @ way + [*(world.tilt_in_odometry * shift), 0.0] + noise
            handed_agl = 40.0
            motion = OdometryMotion(
                truth.t_s[key],
                truth.t_s[i],
                seen * handed_agl,
                np.diag(2.0 * sigma**2) * handed_agl**2,
                truth.yaw_rad[i] - truth.yaw_rad[key] + 0.002 * rng.normal() + key_yaw_noise,
                0.003,
                handed_agl,
                150,
            )
            stream.events.append((truth.t_s[i] + 0.04, "odometry", motion))
            moved = np.linalg.norm(way[:2]) > 0.35 or abs(way[2]) > 0.15
            turned = abs(truth.yaw_rad[i] - truth.yaw_rad[key]) > 0.15
            if not (moved or turned):
                continue
        key, key_noise, key_yaw_noise = i, sigma * rng.normal(size=3), 0.002 * rng.normal()


def _add_fixes(
    stream: Stream, world: World, rng: np.random.Generator, errors: _AttitudeErrors
) -> None:
    truth = stream.truth
    step = round(1.0 / world.fix_hz / DT)
    for i in range(0, len(truth.t_s), step):
        if truth.agl_m[i] < 15.0:
            continue
        t, agl = truth.t_s[i], truth.agl_m[i]
        ne = truth.position_ned_m[i, :2] + agl * errors.nadir_shift(i)
        ne = ne + world.fix_sigma_m * rng.normal(size=2)
        if rng.random() < world.wrong_share:
            angle, far = rng.uniform(0, 2 * math.pi), rng.uniform(10, 200)
            ne = ne + far * np.array([math.cos(angle), math.sin(angle)])
        fix = NedFix(
            t_s=t,
            position_ne_m=ne,
            covariance_ne_m2=np.eye(2) * world.fix_sigma_m**2,
            yaw_rad=errors.heading_in_map(i) + math.radians(0.5) * rng.normal(),
            sigma_yaw_rad=math.radians(0.5),
            agl_m=agl * (1 + 0.02 * rng.normal()),
            sigma_agl_m=0.02 * agl,
        )
        stream.events.append((t + rng.uniform(*world.fix_latency_s), "fix", fix))


def feed(ekf: Ekf, event: tuple) -> object:
    """Hand one event to a filter."""
    _, kind, value = event
    match kind:
        case "attitude":
            return ekf.handle_attitude(value)
        case "height":
            return ekf.handle_height(*value)
        case "odometry":
            return ekf.handle_odometry(value)
        case "fix":
            return ekf.handle_fix(value)
        case "stationary":
            return ekf.handle_stationary(value)
    raise ValueError(kind)


@dataclass
class Run:
    """Estimates at 10 Hz against the truth."""

    t_s: Array
    error_ne_m: Array
    error_v_m_s: Array
    error_yaw_rad: Array
    error_agl_ratio: Array
    P: Array
    sigma_yaw: Array
    estimates: list[Estimate]
    states: list
    innovations: list


def run(
    stream: Stream, config: EkfConfig | None = None, start: Start | None = None, drop=None
) -> Run:
    """Play a stream into a new filter, from the ground; `drop(event)` leaves events out."""
    ekf = Ekf(config or EkfConfig())
    ekf.initialise(start or Start(t_s=0.0, position_ned_m=np.zeros(3), sigma_m=3.0))
    truth = stream.truth
    rows, estimates, states, innovations = [], [], [], []
    next_s = 0.1
    for event in stream.sorted():
        if drop is not None and drop(event):
            continue
        while event[0] >= next_s and next_s < truth.t_s[-1]:
            e = ekf.estimate(next_s)
            i = truth.index(next_s)
            rows.append(_row(e, truth, i))
            estimates.append(e)
            states.append(ekf.state)
            next_s += 0.1
        innovations.append((event, feed(ekf, event)))
    columns = [np.array([row[k] for row in rows]) for k in range(7)]
    return Run(*columns, estimates, states, innovations)


def _row(e: Estimate, truth: Truth, i: int) -> tuple:
    w, x, y, z = e.quat_wxyz
    yaw = math.atan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))
    dyaw = (yaw - truth.yaw_rad[i] + math.pi) % (2 * math.pi) - math.pi
    return (
        e.t_s,
        e.position_ned_m[:2] - truth.position_ned_m[i, :2],
        e.velocity_ned_m_s - truth.velocity_ned_m_s[i],
        dyaw,
        (e.agl_m - truth.agl_m[i]) / max(truth.agl_m[i], 1.0),
        e.covariance,
        e.sigma_yaw_rad,
    )
