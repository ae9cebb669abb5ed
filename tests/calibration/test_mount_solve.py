"""What a flight tells of the mount, over flights whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest
from mount_flights import CX, CY, K1, F, H, Truth, W, fly

from vwnav.calibration.mount.history import AttitudeHistory, heights_at
from vwnav.calibration.mount.solve import fit_mount
from vwnav.geometry.camera import Camera
from vwnav.geometry.rotations import vector_from_rotation

CAMERA = Camera(
    width_px=W, height_px=H, K=np.array([[F, 0, CX], [0, F, CY], [0, 0, 1]]),
    distortion=(K1, 0.0, 0.0, 0.0),
)  # fmt: skip


def fit(truth: Truth, seed: int, focal: bool = False):
    """The fit, and (6,) its errors over its sigmas, and the errors themselves."""
    flight = fly(truth, seed)
    history = AttitudeHistory(flight.attitudes)
    times = np.array([s.t_s for s in flight.sightings])
    heights = heights_at(flight.ranges, history, times + truth.offset_s)
    seen = [replace(s, height_m=float(h)) for s, h in zip(flight.sightings, heights, strict=True)]
    found = fit_mount(CAMERA, history, seen, focal)
    turned = vector_from_rotation(flight.R_body_camera @ found.R_body_camera.T)
    errors = np.array(
        [
            *turned, truth.offset_s - found.offset_s, truth.readout_s - found.readout_s,
            np.log(truth.focal / found.focal_ratio),
        ]
    )  # fmt: skip
    sigmas = np.array(
        [
            *found.sigmas_rad, found.sigma_offset_s, found.sigma_readout_s,
            found.sigma_focal_ratio,
        ]
    )  # fmt: skip
    return found, errors, sigmas
