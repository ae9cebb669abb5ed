"""A multirotor in gusty wind, without images: where it truly was, for the filter's benchmark."""

import math
from dataclasses import dataclass

import numpy as np

from vwnav.types import Array

G_M_S2 = 9.80665
DT_S = 0.01
_HILL_M = 400.0  # from foot to foot
_RELIEF = ((0.012, 0.009, 0.3), (-0.021, 0.011, 1.1), (0.017, -0.026, 2.9), (0.005, 0.024, 4.4))
_SLOWING_S = 2.0  # of the climb, at its end
_LEAD_S = 5.0  # of hovering after the climb
_REACTION_S = 0.2  # of the attitude loop
_TURN_GAIN_PER_S = 4.0
_TURN_LAG_S = 0.1
_GUST_S = 3.0
_MOST_ACCELERATION_M_S2 = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class FilterWorld:
    """The error model: sigmas are drawn once a flight unless they are noises.

    What is asked of the filter (issue and design): wind, gusts, a barometer that drifts, 2 degrees
    of attitude error, fixes 100 to 400 ms late. The rest is as measured in rendered flights and
    recordings (docs/estimation.md says which number comes from where).
    """

    # The flight
    seconds: float = 600.0
    height_m: float = 50.0  # above home
    climb_s: float = 10.0  # from take-off to there, with the slowing down at its end
    speed_m_s: float = 10.0
    leg_s: float = 20.0
    hover_share: float = 0.15  # of the legs
    turn_deg_s: float = 60.0
    headings_deg: tuple[tuple[float, float], ...] = ()  # (time, heading) instead of random legs
    wind_m_s: float = 5.0
    gust_m_s: float = 1.5
    drag_per_s: float = 0.16  # 5.5 degrees of tilt in 6 m/s of wind
    slope_noise: float = 0.01  # of the rise of the ground that ways show
    relief_m: float = 0.5  # of gentle ground, waves of some 200 m to 600 m
    hill_m: float = 0.0  # hills of 400 m from foot to foot
    # Attitude
    tilt_bias_deg: float = 1.9  # per axis; with the drift 2.0
    tilt_drift_deg: float = 0.6  # Gauss-Markov, 20 s
    tilt_noise_deg: float = 0.03
    mount_off_deg: tuple[float, float] = (0.0, 0.0)  # of the camera, about forward and right
    mount_turn_deg: float = 0.0  # the same about down
    focal_off: float = 0.0  # share by which its focal length is taken for longer than it is
    yaw_bias_deg: float = 5.0
    yaw_walk_deg: float = 0.05  # per root second
    yaw_step_deg: float = 0.0  # of the compass, at yaw_step_s
    yaw_step_s: float = 1e9
    # IMU, where it is streamed
    imu_hz: float = 0.0
    imu_bias_m_s2: float = 0.1
    imu_noise_m_s2: float = 0.5  # of a sample: rotors shake it
    gyro_bias_deg_s: float = 0.3
    gyro_noise_deg_s: float = 0.5  # of a sample
    # Barometer
    baro_drift_m: float = 3.0  # over the flight, either way
    baro_noise_m: float = 0.2
    # Fixes
    fix_hz: float = 2.5
    fix_sigma_m: float = 0.5
    map_error_m: float = 0.3  # of the map itself, the same for neighbours within some 50 m
    fix_yaw_deg: float = 0.5
    fix_agl_ratio: float = 0.02
    map_turn_deg: float = 0.2  # of headings by fixes, shared as the map's error is
    map_scale: float = 0.007  # of their heights above ground, likewise
    fix_latency_s: tuple[float, float] = (0.1, 0.4)
    outages_s: tuple[tuple[float, float], ...] = ()
    wrong_share: float = 0.0  # of fixes 10 to 200 m off, each on its own
    wrong_runs_s: tuple[float, ...] = ()  # here begin ten wrong fixes that agree
    # Images
    dated_late_s: float = 0.0  # than they were exposed; a multiple of 10 ms
    # Odometry
    odometry_hz: float = 15.0
    odometry_sigma: float = 0.0016  # of the AGL, an image's own and its keyframe's alike
    odometry_yaw_rad: float = 0.002
    tilt_in_odometry: float = 0.2  # 0: the image itself tells tilting from moving
    # Terrain table of the map
    table: bool = False
    table_offset_m: float = 2.0
    table_error_m: float = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class TrueTrajectory:
    """One flight at 100 Hz: times (n,), positions and velocities (n, 3) NED, quat_wxyz (n, 4)."""

    t_s: Array
    position_ned_m: Array
    velocity_ned_m_s: Array
    quat_wxyz: Array
    yaw_rad: Array
    commanded_yaw_rad: Array
    agl_m: Array

    def index(self, t_s: float) -> int:
        """Of the sample at a time."""
        return min(max(round(t_s / DT_S), 0), len(self.t_s) - 1)


def ground_m(north_m: Array, east_m: Array, world: FilterWorld) -> Array:
    """Height of the ground above home, which stands at a trough."""
    hills = world.hill_m * (1.0 - np.cos(2.0 * math.pi * north_m / _HILL_M)) / 2.0
    waves = sum(
        np.cos(north_m * k_n + east_m * k_e + phase) - math.cos(phase)
        for k_n, k_e, phase in _RELIEF
    )
    return np.asarray(hills + world.relief_m * math.sqrt(2.0 / len(_RELIEF)) * waves)


def fly(world: FilterWorld, rngs: list[np.random.Generator]) -> list[TrueTrajectory]:
    """Climb straight up, then legs of changing course. One flight per generator.

    All are computed side by side; each is the same whatever others are beside it.
    """
    n, runs = round(world.seconds / DT_S), len(rngs)
    wind = np.zeros((runs, 3))
    for wind_of, rng in zip(wind, rngs, strict=True):
        angle = rng.uniform(0.0, 2.0 * math.pi)
        wind_of[:2] = world.wind_m_s * math.cos(angle), world.wind_m_s * math.sin(angle)
    courses, speeds = _commands(world, n, rngs)
    kicks = np.stack([rng.normal(size=(n, 3)) for rng in rngs], axis=1) * [1.0, 1.0, 0.2]
    kicks *= world.gust_m_s * math.sqrt(2.0 * DT_S / _GUST_S)
    p, v, thrust = np.zeros((3, runs, 3))
    gust, yaw, yaw_rate = np.zeros((runs, 3)), courses[0].copy(), np.zeros(runs)
    positions, velocities, thrusts = np.zeros((3, n, runs, 3))
    yaws = np.zeros((n, runs))
    target = np.zeros((runs, 3))
    directions = np.stack([np.cos(courses), np.sin(courses)], axis=2) * speeds[..., None]
    limit_rad_s = math.radians(world.turn_deg_s)
    climb_m_s = -world.height_m / (world.climb_s - _SLOWING_S)
    for i in range(n):
        target[:, :2] = directions[i]
        up_m = -world.height_m if i * DT_S > 0.5 else 0.0
        target[:, 2] = np.clip(up_m - p[:, 2], climb_m_s, 2.0)
        drag = -world.drag_per_s * (v - wind - gust)
        wanted = np.clip(1.5 * (target - v), -_MOST_ACCELERATION_M_S2, _MOST_ACCELERATION_M_S2)
        thrust = thrust + (DT_S / _REACTION_S) * (wanted - drag - thrust)
        turn = np.mod(courses[i] - yaw + math.pi, 2.0 * math.pi) - math.pi
        rate = np.clip(_TURN_GAIN_PER_S * turn, -limit_rad_s, limit_rad_s)
        yaw_rate = yaw_rate + (DT_S / _TURN_LAG_S) * (rate - yaw_rate)
        positions[i], velocities[i], thrusts[i], yaws[i] = p, v, thrust, yaw
        p = p + DT_S * v
        v = v + DT_S * (thrust + drag)
        yaw = yaw + DT_S * yaw_rate
        gust = gust * (1.0 - DT_S / _GUST_S) + kicks[i]
    t_s = np.arange(n, dtype=np.float64) * DT_S
    return [
        TrueTrajectory(
            t_s,
            positions[:, k].copy(),
            velocities[:, k].copy(),
            _attitudes(thrusts[:, k], yaws[:, k]),
            yaws[:, k].copy(),
            courses[:, k].copy(),
            _agl_m(positions[:, k], world),
        )
        for k in range(runs)
    ]


def _agl_m(position_ned_m: Array, world: FilterWorld) -> Array:
    north_m, east_m, down_m = position_ned_m.T
    return np.asarray(-down_m - ground_m(north_m, east_m, world), dtype=np.float64)


def _commands(world: FilterWorld, n: int, rngs: list[np.random.Generator]) -> tuple[Array, Array]:
    """Courses (n, runs) in radians and speeds (n, runs)."""
    t_s = np.arange(n) * DT_S
    legs = int(max(world.seconds - world.climb_s, 0.0) / world.leg_s) + 1
    leg = np.clip(np.floor((t_s - world.climb_s) / world.leg_s), 0, legs - 1).astype(int)
    courses, speeds = np.zeros((2, n, len(rngs)))
    for k, rng in enumerate(rngs):
        turns = np.radians(rng.uniform(60.0, 180.0, legs)) * rng.choice([-1.0, 1.0], legs)
        moving = rng.uniform(size=legs) >= world.hover_share
        first = rng.uniform(-math.pi, math.pi)
        courses[:, k] = first + np.cumsum(turns)[leg]
        speeds[:, k] = world.speed_m_s * moving[leg]
        if world.headings_deg:
            at, headings = np.array(world.headings_deg).T
            which = np.clip(np.searchsorted(at, t_s, side="right") - 1, 0, None)
            courses[:, k] = np.radians(headings)[which]
            speeds[:, k] = world.speed_m_s
    speeds[t_s < world.climb_s + _LEAD_S] = 0.0
    return courses, speeds


def _attitudes(thrust_m_s2: Array, yaw_rad: Array) -> Array:
    """quat_wxyz (n, 4) of the attitudes whose body axis such thrust is along, gravity carried."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    forward = c * thrust_m_s2[:, 0] + s * thrust_m_s2[:, 1]
    right = -s * thrust_m_s2[:, 0] + c * thrust_m_s2[:, 1]
    up = G_M_S2 - thrust_m_s2[:, 2]
    pitch = -np.arctan2(forward, up)
    roll = np.arctan2(right * np.cos(pitch), up)
    half = np.zeros((3, len(yaw_rad)))
    half[0], half[1], half[2] = roll / 2.0, pitch / 2.0, yaw_rad / 2.0
    (cr, cp, cy), (sr, sp, sy) = np.cos(half), np.sin(half)
    return np.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        axis=1,
    )
