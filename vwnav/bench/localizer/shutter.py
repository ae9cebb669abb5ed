"""What a rolling shutter costs, and what is left of it: the same moments seen by three cameras.

A global shutter, a rolling one that nobody told of, and the same images with the rows put back.
The aircraft flies with 12 m/s and turns with 60 degrees a second about some axis; gyro, velocity
and height are told with the errors of a flight, the attitude of the middle row is exact.
"""

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from vwnav.geometry.camera import Camera
from vwnav.geometry.geodesy import LocalFrame
from vwnav.geometry.rotations import euler_from_rotation, rotation_from_euler, rotation_from_vector
from vwnav.maps.image import MapReader
from vwnav.sim.lens import RenderConfig
from vwnav.sim.named_sites import tiles_folder
from vwnav.sim.renderer import CameraRenderer, default_camera
from vwnav.sim.site import Site
from vwnav.types import Array, FeatureExtractor, Frame, MapFix, OdometryMotion, Prior
from vwnav.vision.config import LocalizerConfig, OdometryConfig
from vwnav.vision.localizer import Localizer
from vwnav.vision.odometry.odometry import Odometry

READOUT_S, SPEED_M_S, RATE_RAD_S = 0.02, 12.0, math.radians(60.0)
ASKED = 1.1  # of a global shutter's error, with the rows put back
SHUTTERS = ("global", "rolling, not told", "rolling, rows put back")
_HEIGHT_M, _AROUND_M, _STEP_S = 50.0, 120.0, 0.1
_TILT_RAD, _PRIOR_M, _YAW_RAD, _AGL_RATIO = math.radians(8.0), 3.0, math.radians(2.0), 0.02
_GYRO_RAD_S, _VELOCITY_M_S = math.radians(1.0), 0.3  # one sigma of what is told

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True, eq=False)
class ShutterMoment:
    """How the aircraft flies while two images are taken.

    Attributes:
        position_ned_m, velocity_ned_m_s: (3,). R_ned_body: (3, 3). rates_rad_s: (3,).
        told: what the localizer knows of it.
        told_rates_rad_s, told_velocity_body_m_s: (3,), as gyro and filter have them.
    """

    position_ned_m: Array
    velocity_ned_m_s: Array
    R_ned_body: Array
    rates_rad_s: Array
    told: Prior
    told_rates_rad_s: Array
    told_velocity_body_m_s: Array

    def later(self, t_s: float) -> "ShutterMoment":
        """Turned and flown on."""
        turned = self.R_ned_body @ rotation_from_vector(t_s * self.rates_rad_s)
        there = self.position_ned_m + t_s * self.velocity_ned_m_s
        return replace(self, position_ned_m=there, R_ned_body=turned)


@dataclass(frozen=True, slots=True)
class ShutterRow:
    """Of one camera.

    Attributes:
        fixes, looks: how many of them.
        place_m, place_p95_m: horizontal error of the fixes, root mean square and 95 %.
        yaw_deg, agl_m, way_m: root mean squares of heading, height, and of odometry's way of 0.1 s.
        look_ms: processor time of a look at the map.
    """

    shutter: str
    fixes: int
    looks: int
    place_m: float
    place_p95_m: float
    yaw_deg: float
    agl_m: float
    way_m: float
    look_ms: float


def bench_shutter(
    site: Site, pack: MapReader, extractor: FeatureExtractor, looks: int, seed: int, show: Progress
) -> list[ShutterRow]:
    """A row for each of `SHUTTERS`, over a site and its map."""
    frame = LocalFrame(site.home_lat_deg, site.home_lon_deg, 0.0)
    moments = list(_moments(frame, looks, seed))
    camera = default_camera()
    rows = []
    for name in SHUTTERS:
        told_s = READOUT_S if name == SHUTTERS[2] else 0.0
        seen = replace(camera, readout_s=told_s)
        drawn = _drawn(site, camera, moments, 0.0 if name == SHUTTERS[0] else READOUT_S, seed)
        rows.append(_row(name, seen, frame, moments, drawn, pack, extractor, show))
    return rows


def _moments(frame: LocalFrame, count: int, seed: int) -> Iterator[ShutterMoment]:
    rng = np.random.default_rng([seed, 61])
    for _ in range(count):
        north_m, east_m = rng.uniform(-_AROUND_M, _AROUND_M, 2)
        place = np.array([north_m, east_m, -_HEIGHT_M])
        roll_rad, pitch_rad = rng.normal(0.0, _TILT_RAD, 2)
        yaw_rad, course_rad = rng.uniform(-math.pi, math.pi, 2)
        R = rotation_from_euler(float(roll_rad), float(pitch_rad), float(yaw_rad))
        velocity = SPEED_M_S * np.array([math.cos(course_rad), math.sin(course_rad), 0.0])
        axis = rng.normal(0.0, 1.0, 3)
        rates = RATE_RAD_S * axis / np.linalg.norm(axis)
        near = place + np.array([*rng.normal(0.0, _PRIOR_M, 2), 0.0])
        lat_deg, lon_deg, _ = frame.to_geodetic(near)
        prior = Prior(
            lat_deg=float(lat_deg),
            lon_deg=float(lon_deg),
            sigma_m=_PRIOR_M,
            yaw_rad=float(yaw_rad + rng.normal(0.0, _YAW_RAD)),
            sigma_yaw_rad=_YAW_RAD,
            agl_m=_HEIGHT_M * math.exp(rng.normal(0.0, _AGL_RATIO)),
            sigma_agl_ratio=_AGL_RATIO,
            roll_rad=float(roll_rad),
            pitch_rad=float(pitch_rad),
        )
        told_rates = rates + rng.normal(0.0, _GYRO_RAD_S, 3)
        told_velocity = R.T @ velocity + rng.normal(0.0, _VELOCITY_M_S, 3)
        yield ShutterMoment(place, velocity, R, rates, prior, told_rates, told_velocity)


def _drawn(
    site: Site, camera: Camera, moments: list[ShutterMoment], readout_s: float, seed: int
) -> Iterator[tuple[Frame, Frame]]:
    """Two images of each moment, 0.1 s apart, with what is told of the motion."""
    config = RenderConfig(color=False, background=False, readout_s=readout_s, vibration_rad=0.0)
    rng = np.random.default_rng([seed, 62])
    renderer = CameraRenderer(site, camera, config, rng, tiles_folder(site))
    for number, moment in enumerate(moments):
        pair = []
        for i, each in enumerate((moment, moment.later(_STEP_S))):
            t_s = 10.0 * number + i * _STEP_S
            image = renderer.render(
                each.position_ned_m, each.R_ned_body, t_s, each.velocity_ned_m_s, each.rates_rad_s
            )
            pair.append(
                Frame(
                    t_s, image, 2 * number + i,
                    moment.told_rates_rad_s, moment.told_velocity_body_m_s,
                )
            )  # fmt: skip
        yield pair[0], pair[1]
    renderer.close()


def _row(
    name: str,
    camera: Camera,
    frame: LocalFrame,
    moments: list[ShutterMoment],
    drawn: Iterator[tuple[Frame, Frame]],
    pack: MapReader,
    extractor: FeatureExtractor,
    show: Progress,
) -> ShutterRow:
    localizer = Localizer(pack, extractor, camera, LocalizerConfig(sigma_tilt_rad=0.0))
    errors: list[tuple[float, float, float]] = []
    ways: list[float] = []
    spent_s = 0.0
    for number, (moment, (first, second)) in enumerate(zip(moments, drawn, strict=True)):
        begin_s = time.process_time()
        fix = localizer.localize(first, moment.told, number)
        spent_s += time.process_time() - begin_s
        if isinstance(fix, MapFix) and fix.yaw_rad is not None and fix.agl_m is not None:
            errors.append(_errors(fix, moment, frame))
        odometry = Odometry(camera, OdometryConfig())
        odometry.step(first, moment.R_ned_body, _HEIGHT_M)
        way = odometry.step(second, moment.later(_STEP_S).R_ned_body, _HEIGHT_M)
        if isinstance(way, OdometryMotion):
            off = way.displacement_ned_m - _STEP_S * moment.velocity_ned_m_s
            ways.append(math.hypot(*off[:2].tolist()))
        show(name, number + 1, len(moments))
    place_m, yaw_rad, agl_m = np.array(errors).reshape(-1, 3).T
    return ShutterRow(
        shutter=name,
        fixes=len(errors),
        looks=len(moments),
        place_m=_rms(place_m),
        place_p95_m=float(np.quantile(place_m, 0.95)) if len(place_m) else math.nan,
        yaw_deg=math.degrees(_rms(yaw_rad)),
        agl_m=_rms(agl_m),
        way_m=_rms(np.array(ways)),
        look_ms=1e3 * spent_s / len(moments),
    )


def _errors(fix: MapFix, moment: ShutterMoment, frame: LocalFrame) -> tuple[float, float, float]:
    """Of place, heading and height."""
    there = frame.to_ned(fix.lat_deg, fix.lon_deg, 0.0)
    off_m = math.dist(there[:2].tolist(), moment.position_ned_m[:2].tolist())
    yaw_rad = (fix.yaw_rad or 0.0) - euler_from_rotation(moment.R_ned_body)[2]
    off_rad = math.remainder(yaw_rad, 2.0 * math.pi)
    return off_m, off_rad, (fix.agl_m or 0.0) + float(moment.position_ned_m[2])


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else math.nan
