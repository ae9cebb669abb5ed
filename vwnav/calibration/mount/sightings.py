"""Map points in the images of a flight: localized, then registered once more at that place."""

import time
from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from vwnav.calibration.mount.flight_file import FlightFile
from vwnav.calibration.mount.history import FlownAttitudes, camera_heights_at
from vwnav.calibration.mount.problem import Sighting
from vwnav.geometry.camera import Camera
from vwnav.geometry.geodesy import LocalFrame, lat_lon_from_mercator_px
from vwnav.geometry.homography import transform_points
from vwnav.geometry.rotations import euler_from_rotation, wrap_pi
from vwnav.maps.pack import MapPack
from vwnav.types import Array, FeatureExtractor, Frame, MapFix, Prior
from vwnav.vision.candidates import Acceptance, Candidate, Hypothesis, fine_level
from vwnav.vision.config import LocalizerConfig
from vwnav.vision.localizer import Localizer
from vwnav.vision.query import Query
from vwnav.vision.registration import REFINED, Registration, register

TILT_OPEN_RAD = np.radians(8.0)  # of a mount that nobody measured
SIGMA_YAW_RAD = np.radians(12.0)
SPEED_M_S = 15.0  # at most, between two images that were found
NEAR_SIGMA_M = 8.0
KEEP_LOG10_NFA = -4.0
KEYPOINTS = 1000
# Of the map: what is cut off closely about a transform that knows of no rolling shutter agrees with
# it too well, and the read-out comes out short.
WIDE_PX = 7.0


class Spotter:
    """Finds map points in one camera's images."""

    def __init__(
        self,
        pack: MapPack,
        extractor: FeatureExtractor,
        camera: Camera,
        flight: FlightFile,
        history: FlownAttitudes,
        offset_s: float = 0.0,
    ) -> None:
        """Prepare.

        Args:
            pack: the map.
            extractor: of its features.
            camera: with the mount as far as it is known.
            flight: what was told beside the images.
            history: its attitudes.
            offset_s: what to add to the images' stamps.
        """
        config = LocalizerConfig(sigma_tilt_rad=float(TILT_OPEN_RAD))
        self._config = config
        self._arm_m = camera.t_body_camera_m
        camera = camera.without_arm()  # sought are the camera's own places
        self._pack, self._extractor, self._camera = pack, extractor, camera
        self._localizer = Localizer(pack, extractor, camera, config)
        self._flight, self._history, self._offset_s = flight, history, offset_s
        self.frame = LocalFrame(*pack.middle, 0.0)
        self._last: MapFix | None = None

    def spot(self, image: Frame) -> Sighting | None:
        """The map points that an image shows; None where it is not found."""
        at_s = np.array([image.t_s + self._offset_s])
        turned = self._history.at(at_s)
        if not turned.known[0]:
            return None
        height_m = float(
            camera_heights_at(self._flight.ranges, self._history, at_s, self._arm_m)[0]
        )
        prior = self._prior(image.t_s, turned.R_ned_body[0], height_m)
        fix = self._localizer.localize(image, prior, image.index)
        if not isinstance(fix, MapFix) or fix.yaw_rad is None or fix.agl_m is None:
            return None
        self._last = fix
        found = self._registered(image, prior, fix)
        return None if found is None else self._sighting(image, found, fix, height_m)

    def _prior(self, t_s: float, R_ned_body: Array, height_m: float) -> Prior:
        """The attitude as the autopilot has it; the place as the flight, or the last image."""
        roll_rad, pitch_rad, yaw_rad = euler_from_rotation(R_ned_body)
        prior = Prior(
            roll_rad=roll_rad, pitch_rad=pitch_rad, yaw_rad=yaw_rad, sigma_yaw_rad=SIGMA_YAW_RAD
        )
        last, told = self._last, self._flight.place_near(t_s)
        if last is not None:
            sigma_m = NEAR_SIGMA_M + SPEED_M_S * abs(t_s - last.t_s)
            prior = replace(
                prior, lat_deg=last.lat_deg, lon_deg=last.lon_deg, sigma_m=sigma_m, agl_m=last.agl_m
            )
        elif told is not None:
            sigma_m = 3.0 * NEAR_SIGMA_M + SPEED_M_S * abs(t_s - told.t_s)
            prior = replace(
                prior, lat_deg=told.lat_deg, lon_deg=told.lon_deg, sigma_m=sigma_m, agl_m=told.agl_m
            )
        if np.isfinite(height_m):
            prior = replace(prior, agl_m=height_m)
        return prior

    def _registered(self, image: Frame, prior: Prior, fix: MapFix) -> Registration | None:
        """The image on the map's sharpest level at the place that was found."""
        assert fix.yaw_rad is not None
        assert fix.agl_m is not None
        query = Query(self._camera, self._extractor, image, prior, image.index, time.perf_counter)
        level = fine_level(self._pack, query, fix.agl_m, self._config.max_view_area_px)
        candidate = Candidate(
            hypothesis=Hypothesis(float(wrap_pi(fix.yaw_rad)), fix.agl_m, REFINED),
            level=level,
            lat_deg=fix.lat_deg,
            lon_deg=fix.lon_deg,
            radius_m=0.1 * fix.agl_m,
            max_keypoints=KEYPOINTS,
        )
        made = query.rectify(fix.yaw_rad, fix.agl_m, candidate.m_per_px)
        if made is None:
            return None
        window = candidate.window(made)
        points = self._pack.features_in(level.zoom, *window, self._extractor)
        view = query.view(fix.yaw_rad, made, KEYPOINTS)
        accept = Acceptance(
            threshold_px=WIDE_PX,
            max_log10_nfa=KEEP_LOG10_NFA,
            weak_log10_nfa=KEEP_LOG10_NFA,
            sigma_tilt_rad=float(TILT_OPEN_RAD),
            sigma_georeference_m=0.0,
        )
        found = register(query, candidate, view, points, accept)
        return found if isinstance(found, Registration) else None

    def _sighting(
        self, image: Frame, found: Registration, fix: MapFix, height_m: float
    ) -> Sighting:
        """Pixels of the image as it was taken, and the places of the map's points."""
        H_rect_frame = found.view.rectification.H_rect_frame
        H_frame_view = np.asarray(np.linalg.inv(H_rect_frame), np.float64)
        straight = transform_points(H_frame_view, found.consensus.uv_view)
        rays = self._camera.undistorted().bearings(straight)
        xy = found.piece.origin_px + found.consensus.uv_map + 0.5
        lat_deg, lon_deg = lat_lon_from_mercator_px(xy[:, 0], xy[:, 1], found.candidate.level.zoom)
        ground = self.frame.to_ned(lat_deg, lon_deg, 0.0)
        ground[:, 2] = 0.0
        place = self.frame.to_ned(fix.lat_deg, fix.lon_deg, 0.0)
        place[2] = -(fix.agl_m or 0.0)
        return Sighting(
            image.t_s,
            self._camera.project(rays),
            ground,
            found.consensus.cells,
            place,
            height_m,
        )


def spot_all(
    spotter: Spotter,
    images: Iterable[Frame],
    total: int,
    progress: Callable[[str, int, int], None],
) -> list[Sighting]:
    """The sightings of all images that are found."""
    found = []
    for number, image in enumerate(images, 1):
        sighting = spotter.spot(image)
        if sighting is not None:
            found.append(sighting)
        progress("pictures", number, total)
    return found
