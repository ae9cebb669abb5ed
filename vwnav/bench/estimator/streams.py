"""What the sensors say of a flight, late and wrong as `FilterWorld` has it."""

import math
from dataclasses import dataclass

import numpy as np

from vwnav.bench.estimator.attitude_errors import AttitudeErrors, multiply
from vwnav.bench.estimator.world import DT_S, G_M_S2, FilterWorld, TrueTrajectory, ground_m
from vwnav.estimation.events import NedFix
from vwnav.estimation.inputs import Measurement
from vwnav.geometry.rotations import rotation_from_quat, rotation_from_vector, wrap_pi
from vwnav.types import Array, Attitude, Height, ImuSample, OdometryMotion

LEAST_FIX_AGL_M = 15.0
LEAST_ODOMETRY_AGL_M = 1.5
WRONG_IN_A_ROW = 10
_ATTITUDE_LATE_S = 0.01
_IMU_LATE_S = 0.012
_HEIGHT_LATE_S = 0.03
_ODOMETRY_LATE_S = 0.04
_HANDED_AGL_M = 40.0  # odometry is scaled by whatever AGL it is handed; the filter undoes it
_KEYFRAME_WAY = 0.35  # in AGL, then the keyframe is replaced
_KEYFRAME_CLIMB = 0.12
_KEYFRAME_TURN_RAD = 0.14
_TOLD_TILT_RAD = math.radians(0.2)  # what attitudes leave open, as odometry has it
_LEAST_SLOPE_WAY = 0.05  # in AGL, of one that tells how the ground rises
_SLOPE_STEP_M = 5.0
_MAP_WAVES = 24
_MAP_LENGTH_M = 50.0


@dataclass(frozen=True, slots=True, eq=False)
class MeasurementEvent:
    """Something that reaches the filter. `error_m`: how wrong a fix is, tilt left aside."""

    arrival_s: float
    seen: Measurement
    error_m: float = 0.0


@dataclass(frozen=True, slots=True)
class Table:
    """The map's terrain heights: of another datum, and not quite right."""

    world: FilterWorld
    offset_m: float
    phases: tuple[float, float]

    def __call__(self, north_m: float, east_m: float) -> float:
        """Height of the ground."""
        a, b = self.phases
        wave = math.cos(north_m / 60.0 + a) * math.cos(east_m / 60.0 + b)
        true_m = float(ground_m(np.array(north_m), np.array(east_m), self.world))
        return true_m + self.offset_m + 2.0 * self.world.table_error_m * wave


@dataclass(frozen=True, slots=True, eq=False)
class MeasurementStream:
    """All that a filter is told of one flight.

    Attributes:
        measured_yaw_rad: (n,) heading as the autopilot has it, at the truth's times.
        measured_quats: (n, 4) its attitude; None where only its heading is kept.
        ground: the map's terrain table.
    """

    truth: TrueTrajectory
    events: list[MeasurementEvent]
    measured_yaw_rad: Array
    ground: Table | None = None
    measured_quats: Array | None = None


def sense(world: FilterWorld, truth: TrueTrajectory, rng: np.random.Generator) -> MeasurementStream:
    """The streams of one flight."""
    errors = AttitudeErrors(world, truth, rng)
    events = [
        *_attitudes(truth, errors),
        *_heights(world, truth, rng),
        *_odometry(world, truth, errors, rng),
        *_fixes(world, truth, errors, rng),
    ]
    if world.imu_hz > 0.0:
        events += _imu(world, truth, rng)
    events.sort(key=lambda event: event.arrival_s)
    measured = truth.yaw_rad + errors.yaw
    table = _table(world, rng) if world.table else None
    return MeasurementStream(truth, events, measured, table, errors.quats)


def _attitudes(truth: TrueTrajectory, errors: AttitudeErrors) -> list[MeasurementEvent]:
    times = truth.t_s.tolist()
    return [
        MeasurementEvent(times[i] + _ATTITUDE_LATE_S, Attitude(times[i], errors.quats[i]))
        for i in range(0, len(times), 2)
    ]


def _imu(
    world: FilterWorld, truth: TrueTrajectory, rng: np.random.Generator
) -> list[MeasurementEvent]:
    acceleration = np.gradient(truth.velocity_ned_m_s, truth.t_s, axis=0)
    bias = world.imu_bias_m_s2 * rng.normal(size=3)
    rate_bias = math.radians(world.gyro_bias_deg_s) * rng.normal(size=3)
    rates = _rates(truth)
    events = []
    for i in range(0, len(truth.t_s), round(1.0 / world.imu_hz / DT_S)):
        R_ned_body = rotation_from_quat(truth.quat_wxyz[i])
        force = R_ned_body.T @ (acceleration[i] - [0.0, 0.0, G_M_S2])
        force += bias + world.imu_noise_m_s2 * rng.normal(size=3)
        rate = rates[i] + rate_bias + math.radians(world.gyro_noise_deg_s) * rng.normal(size=3)
        t_s = float(truth.t_s[i])
        events.append(MeasurementEvent(t_s + _IMU_LATE_S, ImuSample(t_s, force, rate)))
    return events


def _rates(truth: TrueTrajectory) -> Array:
    """(n, 3) body rates, rad/s."""
    conjugate = truth.quat_wxyz * [1.0, -1.0, -1.0, -1.0]
    steps = multiply(conjugate[:-1], truth.quat_wxyz[1:])
    between = 2.0 * np.sign(steps[:, :1]) * steps[:, 1:] / DT_S
    return np.vstack([between[:1], 0.5 * (between[:-1] + between[1:]), between[-1:]])


def _heights(
    world: FilterWorld, truth: TrueTrajectory, rng: np.random.Generator
) -> list[MeasurementEvent]:
    which = range(0, len(truth.t_s), 10)
    drift_m = world.baro_drift_m * rng.choice([-1.0, 1.0]) * truth.t_s / truth.t_s[-1]
    heights = (
        drift_m - truth.position_ned_m[:, 2] + world.baro_noise_m * rng.normal(size=len(drift_m))
    )
    return [
        MeasurementEvent(
            float(truth.t_s[i]) + _HEIGHT_LATE_S, Height(float(truth.t_s[i]), float(heights[i]))
        )
        for i in which
    ]


def _odometry(
    world: FilterWorld, truth: TrueTrajectory, errors: AttitudeErrors, rng: np.random.Generator
) -> list[MeasurementEvent]:
    """Ways from keyframes that are replaced as the view changes; the first image is one."""
    events: list[MeasurementEvent] = []
    late_s = world.dated_late_s
    sigma = world.odometry_sigma * np.array([0.7, 0.7, 0.4])
    covariance = np.diag(2.0 * sigma**2) * _HANDED_AGL_M**2
    sigma_yaw_rad = math.sqrt(2.0) * world.odometry_yaw_rad
    tilt_shift = errors.nadir_shift - errors.focal_shift
    share = world.tilt_in_odometry
    shift = share * tilt_shift + (2.0 - share) * errors.focal_shift
    in_heights = np.array([1.0 - world.focal_off, 1.0 - world.focal_off, 1.0])
    key, key_noise, key_turn, key_yaw = None, np.zeros(3), np.eye(3), 0.0
    for i in range(0, len(truth.t_s), round(1.0 / world.odometry_hz / DT_S)):
        if truth.agl_m[i] < LEAST_ODOMETRY_AGL_M:
            key = None
            continue
        if key is not None:
            way = (truth.position_ned_m[i] - truth.position_ned_m[key]) / truth.agl_m[key]
            seen = key_turn @ (in_heights * way) + sigma * rng.normal(size=3) + key_noise
            seen[:2] += shift[i] - shift[key]
            # Of attitudes that share their tilt error, as the map's heading is.
            turned_rad = wrap_pi(float(errors.map_yaw[i] - errors.map_yaw[key]))
            increment_rad = turned_rad + world.odometry_yaw_rad * float(rng.normal()) + key_yaw
            motion = OdometryMotion(
                float(truth.t_s[key]) + late_s, float(truth.t_s[i]) + late_s,
                seen * _HANDED_AGL_M, covariance,
                increment_rad, sigma_yaw_rad, _HANDED_AGL_M, 150, world.tilt_in_odometry,
                _tilts_along(world, truth.quat_wxyz[[key, i]], errors.tilted[[key, i]]),
                *_slope_seen(world, truth, errors, key, i),
            )  # fmt: skip
            events.append(MeasurementEvent(motion.t1_s + _ODOMETRY_LATE_S, motion))
            moved = math.hypot(way[0], way[1]) > _KEYFRAME_WAY or abs(way[2]) > _KEYFRAME_CLIMB
            if not (moved or abs(turned_rad) > _KEYFRAME_TURN_RAD):
                continue
        key, key_noise = i, sigma * rng.normal(size=3)
        key_yaw = world.odometry_yaw_rad * float(rng.normal())
        turn = rotation_from_vector([0.0, 0.0, errors.seen_yaw[key] - errors.mount_turn])
        key_turn = turn @ rotation_from_vector([*errors.seen_ne[key], 0.0])
    return events


def _slope_seen(
    world: FilterWorld, truth: TrueTrajectory, errors: AttitudeErrors, key: int, now: int
) -> tuple[Array | None, Array | None]:
    """Rise of the ground about a keyframe as its attitude has it, and covariance, of a long way."""
    place, tilt = truth.position_ned_m[key, :2], errors.seen_ne[key]
    way_m = float(np.hypot(*(truth.position_ned_m[now, :2] - place)))
    if way_m < _LEAST_SLOPE_WAY * truth.agl_m[key]:
        return None, None
    around = place + np.array([[_SLOPE_STEP_M, 0.0], [0.0, _SLOPE_STEP_M]])
    ahead, behind = (ground_m(at[:, 0], at[:, 1], world) for at in (around, 2.0 * place - around))
    rise = (ahead - behind) / (2.0 * _SLOPE_STEP_M) + np.array([tilt[1], -tilt[0]])
    c, s = math.cos(errors.seen_yaw[key]), math.sin(errors.seen_yaw[key])
    as_told = np.array([[c, -s], [s, c]]) @ rise
    noise = np.random.default_rng([key, now]).normal(size=2)
    return as_told + world.slope_noise * noise, world.slope_noise**2 * np.eye(2)


def _tilts_along(world: FilterWorld, true_quats: Array, told_quats: Array) -> float:
    """As `ground_motion.tilt_seen` has it, of two attitudes (2, 4) each, as they were and are told.

    What of a tilt that nobody told is not taken for motion is seen. What is told is without the
    heading's error, which the image shows.
    """
    true, told = _tilted_rad(*true_quats), _tilted_rad(*told_quats)
    k = 1.0 - world.tilt_in_odometry
    return float(k * told @ (true - 0.5 * told)) / _TOLD_TILT_RAD**2


def _tilted_rad(quat0: Array, quat1: Array) -> Array:
    """(2,) turn of the body's down axis between two attitudes, about north and east."""
    return np.cross(rotation_from_quat(quat0)[:, 2], rotation_from_quat(quat1)[:, 2])[:2]


def _fixes(
    world: FilterWorld, truth: TrueTrajectory, errors: AttitudeErrors, rng: np.random.Generator
) -> list[MeasurementEvent]:
    events: list[MeasurementEvent] = []
    map_error = world.map_error_m * _waves(truth, 2, rng)
    map_turn_rad = math.radians(world.map_turn_deg) * _waves(truth, 1, rng)[:, 0]
    map_scale = world.map_scale * _waves(truth, 1, rng)[:, 0]
    wrong_left, wrong_m = 0, np.zeros(2)
    starts = sorted(world.wrong_runs_s, reverse=True)
    covariance = np.eye(2) * (world.fix_sigma_m**2 + world.map_error_m**2)
    for i in range(0, len(truth.t_s), round(1.0 / world.fix_hz / DT_S)):
        t_s, agl_m = float(truth.t_s[i]), float(truth.agl_m[i])
        noise = rng.normal(size=4)
        late_s = rng.uniform(*world.fix_latency_s)
        random_wrong = rng.random() < world.wrong_share
        offset = _offset(rng)
        if agl_m < LEAST_FIX_AGL_M or any(a <= t_s < b for a, b in world.outages_s):
            continue
        error = world.fix_sigma_m * noise[:2] + map_error[i]
        if starts and t_s >= starts[-1]:
            starts.pop()
            wrong_left, wrong_m = WRONG_IN_A_ROW, offset
        if wrong_left > 0:
            wrong_left -= 1
            error = error + wrong_m
        elif random_wrong:
            error = error + offset
        yaw_sigma_rad = math.radians(world.fix_yaw_deg)
        yaw_rad = errors.map_yaw[i] + errors.mount_turn + map_turn_rad[i]
        fix = NedFix(
            t_s=t_s + world.dated_late_s,
            position_ne_m=truth.position_ned_m[i, :2] + agl_m * errors.nadir_shift[i] + error,
            covariance_ne_m2=covariance,
            yaw_rad=wrap_pi(float(yaw_rad + yaw_sigma_rad * noise[2])),
            sigma_yaw_rad=yaw_sigma_rad,
            agl_m=agl_m
            * (1.0 + world.focal_off + float(map_scale[i]) + world.fix_agl_ratio * float(noise[3])),
            sigma_agl_m=world.fix_agl_ratio * agl_m,
            sigma_map_m=world.map_error_m,
        )
        events.append(MeasurementEvent(fix.t_s + late_s, fix, float(np.hypot(*error))))
    return events


def _offset(rng: np.random.Generator) -> Array:
    """10 to 200 m in any direction."""
    angle, far_m = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(10.0, 200.0)
    return far_m * np.array([math.cos(angle), math.sin(angle)])


def _waves(truth: TrueTrajectory, count: int, rng: np.random.Generator) -> Array:
    """(n, count) errors of unit size of the map below: waves of random length, some 50 m."""
    waves = rng.normal(size=(_MAP_WAVES, 2)) / _MAP_LENGTH_M
    phases = rng.uniform(0.0, 2.0 * math.pi, (count, _MAP_WAVES))
    along = truth.position_ned_m[:, :2] @ waves.T
    size = math.sqrt(2.0 / _MAP_WAVES)
    return np.stack([size * np.sum(np.cos(along + p), axis=1) for p in phases], axis=1)


def _table(world: FilterWorld, rng: np.random.Generator) -> Table:
    phases = rng.uniform(0.0, 2.0 * math.pi, 2).tolist()
    return Table(world, world.table_offset_m * float(rng.normal()), (phases[0], phases[1]))
