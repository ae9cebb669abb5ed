"""What `vwnav calibrate camera` does, once its options are read."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from vwnav.calibration.board_session import BoardSession
from vwnav.calibration.coverage import ENOUGH_COVERED, Coverage
from vwnav.calibration.lens import NAMES, LensFit, fit_lens
from vwnav.calibration.output import check_writable
from vwnav.cameras.sources import open_source
from vwnav.errors import CalibrationError
from vwnav.geometry.calibration import save_camera
from vwnav.screen import print_table, say

GOOD_HELD_OUT, BAD_HELD_OUT = 0.0008, 0.004  # of the image's width
GOOD_FOCAL, BAD_FOCAL = 0.001, 0.01  # sigma, of the focal length
LEAST_LEAN_RAD = math.radians(8.0)
GOOD_CENTRE = 0.001  # sigma of the principal point, of the image's width


def calibrate_camera(source: str, output: Path) -> None:
    """Watch the board, fit the lens, write the calibration file and print what it is worth.

    Raises:
        VwnavError: the file cannot be written, of the source, or the images fix no lens.
    """
    check_writable(output)
    images = open_source(source)
    session = BoardSession(images)
    try:
        fit = _watch(session)
    finally:
        images.close()
    coverage = session.coverage
    doubts = _doubts(fit, coverage)
    verdict = "good" if not doubts else "usable"
    findings = {
        "verdict": verdict,
        "held_out_px": round(fit.held_out_px, 4),
        "views": fit.views,
        **{f"sigma_{name}": float(f"{sigma:.3g}") for name, sigma in fit.sigmas.items()},
    }
    save_camera(replace(fit.camera, sensor_mode=session.mode), output, findings)
    for doubt in doubts:
        say(doubt)
    rows = _rows(fit, coverage, verdict, output)
    if session.mode is not None:
        rows.append(("mode of the sensor", str(session.mode)))
    print_table("camera calibration", rows)


def _watch(session: BoardSession) -> LensFit:
    """Until the views fix a lens; who takes too few of a live camera is told, and may go on.

    Raises:
        VwnavError: of the source; the images fix no lens, and no more were shown.
    """
    while True:
        before = len(session.coverage.views)
        session.watch()
        views = len(session.coverage.views)
        try:
            return _fitted(session)
        except CalibrationError as error:
            if not session.cut_short or views == before:
                raise
            say(f"{error}; {views} views are kept: go on, or Ctrl-C again gives them up")


def _fitted(session: BoardSession) -> LensFit:
    """The lens of what was shown.

    Raises:
        CalibrationError: there is nothing that fixes one.
    """
    coverage = session.coverage
    if not coverage.views:
        raise CalibrationError(
            f"the board is in none of {session.seen} pictures: `vwnav calibrate board` draws it; "
            "it wants light, a sharp picture, and a white margin"
        )
    fit = fit_lens(coverage.views, session.size_wh)
    _refuse_useless(fit, coverage)
    return fit


def _doubts(fit: LensFit, coverage: Coverage) -> list[str]:
    """What keeps a calibration from being good."""
    width_px = fit.camera.width_px
    focal = max(fit.sigmas["fx_px"] / fit.camera.K[0, 0], fit.sigmas["fy_px"] / fit.camera.K[1, 1])
    centre_px = max(fit.sigmas["cx_px"], fit.sigmas["cy_px"])
    found = []
    if fit.held_out_px > GOOD_HELD_OUT * width_px:
        found.append(
            f"corners are off by {fit.held_out_px:.2f} px: is the board flat, the picture sharp, "
            "the focus fixed?"
        )
    if focal > GOOD_FOCAL:
        found.append(f"the focal length is known to {100.0 * focal:.2f} % only: more tilted views")
    if centre_px > GOOD_CENTRE * width_px:
        found.append(f"the principal point is known to {centre_px:.1f} px only: more tilted views")
    if coverage.covered < ENOUGH_COVERED:
        found.append(f"{100.0 * coverage.covered:.0f} % of the picture was covered")
    return found + [f"never shown: {each}" for each in coverage.missing()]


def _refuse_useless(fit: LensFit, coverage: Coverage) -> None:
    """A lens that these views do not fix is not written.

    Raises:
        CalibrationError: with what to show instead.
    """
    focal = fit.sigmas["fx_px"] / float(fit.camera.K[0, 0])
    if coverage.most_leaning < LEAST_LEAN_RAD or not math.isfinite(focal):
        raise CalibrationError(
            "the board faces the camera in all pictures, which tells no focal length: tilt it, by "
            "30 degrees to each side"
        )
    wanted = "; ".join(coverage.missing()) or "sharper pictures of a flat board"
    if focal > BAD_FOCAL:
        raise CalibrationError(
            f"these pictures fix the focal length to {100.0 * focal:.1f} % only, "
            f"{100.0 * BAD_FOCAL:.0f} % is the least; missing: {wanted}"
        )
    if fit.held_out_px > BAD_HELD_OUT * fit.camera.width_px:
        raise CalibrationError(
            f"no lens fits these pictures: corners are off by {fit.held_out_px:.1f} px; is it one "
            "camera with a fixed focus, and the board flat?"
        )


def _rows(fit: LensFit, coverage: Coverage, verdict: str, output: Path) -> list[tuple[str, str]]:
    K, camera = fit.camera.K, fit.camera
    values = dict(zip(NAMES, (K[0, 0], K[1, 1], K[0, 2], K[1, 2]), strict=True))
    middle_px, last_px = (camera.height_px - 1) / 2.0, camera.width_px - 1.0
    corner, other = camera.bearings(np.array([[0.0, middle_px], [last_px, middle_px]]))
    wide_deg = math.degrees(math.acos(min(1.0, float(corner @ other))))
    rows = [("verdict", verdict), ("model", camera.model)]
    rows += [
        (name.removesuffix("_px"), f"{value:.2f} +- {fit.sigmas[name]:.2f} px")
        for name, value in values.items()
    ]
    terms = [name for name in fit.sigmas if name not in NAMES]
    rows += [
        (name, f"{value:.5f} +- {fit.sigmas[name]:.5f}")
        for name, value in zip(terms, camera.distortion, strict=True)
    ]
    return [
        *rows,
        ("field of view across", f"{wide_deg:.1f} degrees"),
        ("error of corners held out", f"{fit.held_out_px:.3f} px"),
        ("error of corners fitted", f"{fit.rms_px:.3f} px"),
        ("views, of the picture covered", f"{fit.views}, {100.0 * coverage.covered:.0f} %"),
        ("written to", str(output)),
    ]
