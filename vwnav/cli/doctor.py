"""`vwnav doctor`: is this machine, and the drone on the link, ready?"""

import json
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import typer

from vwnav.cli.features import ConfigOption, FeaturesOption, ModelOption
from vwnav.errors import PreflightError, VwnavError
from vwnav.safety.check import Check, CheckVerdict

if TYPE_CHECKING:
    from vwnav.config import Config
    from vwnav.geometry.camera import Camera
    from vwnav.guidance.plan_files import Route, RouteFrame
    from vwnav.safety.camera_watch import CameraSight
    from vwnav.safety.safety_config import SafetyConfig
    from vwnav.seams import FrameSource
    from vwnav.types import FeatureExtractor

FRAME_BUDGET_MS = 100.0  # a fix is wanted several times a second beside odometry
_BUDGET_SHARE = 0.5  # of the interval, where the settings want fixes more seldom
_WATCHED, _WATCHED_S = 30, 5.0  # images, and for how long at most
_STEADY = 8  # images in a row without trouble; the first ones of a camera may be old
_FIT_UNTOLD = "whether they fit a calibration is not known: --camera FILE tells"
_MODE_UNTOLD = "whether its sensor is in the calibrated mode ({}) it does not say"
_KEPT = "kept pictures, no camera's: their rate and times are not looked at, and fly refuses them"
_HOME_UNTOLD = (
    "whether it covers the route is not known, which counts in metres from home: "
    "`vwnav map check PACK --route FILE --home LAT,LON` tells"
)
# MAVSDK asks nobody whether a port is free, and two who read one take it from each other.
_LINK_TAKEN = "a watchdog has that link: end its vwnav first, which flies or gets ready to"


def doctor(
    map_path: Path | None = typer.Option(None, "--map", help="Map pack to check."),
    route: Path | None = typer.Option(None, help="Route to check against the map."),
    camera: Path | None = typer.Option(None, help="Camera calibration to check."),
    video: str | None = typer.Option(None, help="Camera to open: /dev/video0, rtsp://, a file."),
    connection: str | None = typer.Option(None, help="Autopilot link, e.g. udpin://0.0.0.0:14540."),
    features: FeaturesOption = None,
    model: ModelOption = None,
    config_path: ConfigOption = None,
    route_frame: Literal["local", "global"] = typer.Option(
        "local", help="Text routes: local (north, east, height in m) or global (lat, lon, height)."
    ),
    as_json: bool = typer.Option(False, "--json", help="One JSON object on stdout."),
) -> None:
    """Check machine, model, and whatever is named: map, route, camera, autopilot.

    `--features`, `--model`, `--config` and `--route-frame` are those that `fly` will be given.
    """
    from vwnav.config import load_config, with_features

    config = with_features(load_config(config_path), features, model)
    checks = list(_machine())
    check, extractor = _features(config)
    checks.append(check)
    flown: Route | None = None
    if route:
        check, flown = _route(route, route_frame)
        checks.append(check)
    if map_path:
        checks.append(
            _guarded("map", lambda: _map(map_path, flown, camera, extractor, config.safety))
        )
    if camera:
        checks.append(_guarded("calibration", lambda: _calibration(camera)))
    if video is not None:
        checks.append(_guarded("camera", lambda: _camera(video, camera)))
    if connection is not None:
        checks += _autopilot(connection, config)
    _print(checks, as_json)
    failed = [check.name for check in checks if check.verdict == "FAIL"]
    if failed:
        raise PreflightError(f"not ready: {', '.join(failed)} (see the table above)")


def _guarded(name: str, check: Callable[[], Check]) -> Check:
    try:
        return check()
    except VwnavError as error:
        return Check(name, "FAIL", str(error))


def _machine() -> Iterator[Check]:
    import cv2
    import numpy as np
    import onnxruntime

    from vwnav.onboard.board import check_board, recordings_folder

    yield Check(
        "libraries",
        "PASS",
        f"Python {sys.version.split()[0]}, numpy {np.__version__}, OpenCV {cv2.__version__}, "
        f"onnxruntime {onnxruntime.__version__}",
    )
    yield from check_board(recordings_folder(Path.cwd()))


def _features(config: "Config") -> "tuple[Check, FeatureExtractor]":
    """What `fly` would look with, and how long that takes; SIFT where it would fall back to it."""
    import cv2

    from vwnav.assemble import choose_features
    from vwnav.vision.features.load import largest_view

    cv2.setNumThreads(1)  # as in flight
    said: list[str] = []
    extractor, _ = choose_features(config.features, said.append)
    view, keypoints = largest_view(config.localizer), config.localizer.max_keypoints
    times_ms = []
    for _ in range(6):
        start_s = time.perf_counter()
        extractor.extract(view, keypoints)
        times_ms.append((time.perf_counter() - start_s) * 1e3)
    spent_ms = sorted(times_ms)[len(times_ms) // 2]
    budget_ms = max(FRAME_BUDGET_MS, _BUDGET_SHARE * 1e3 * config.pipeline.fix_interval_s)
    told = (
        f"{extractor.feature_set_id}: {spent_ms:.0f} ms for {view.shape[1]}x{view.shape[0]}, "
        f"{keypoints} keypoints (budget {budget_ms:.0f} ms)"
    )
    verdict: CheckVerdict = "WARN" if said or spent_ms > budget_ms else "PASS"
    return Check(f"{config.features.name} features", verdict, "; ".join([*said, told])), extractor


def _map(
    path: Path,
    route: "Route | None",
    calibration: Path | None,
    extractor: "FeatureExtractor",
    safety: "SafetyConfig",
) -> Check:
    from vwnav.geometry.calibration import load_camera
    from vwnav.maps.coverage import begins_too_low
    from vwnav.maps.pack import MapPack
    from vwnav.onboard.flight_plan import route_on_map

    with MapPack.open(path) as pack:
        pack.check_features(extractor)
        sets = ", ".join(each.name for each in pack.feature_sets) or "no features"
        finest = min(level.m_per_px for level in pack.levels)
        detail = f"{pack.name}: {len(pack.levels)} levels from {finest:.2f} m/px, {sets}"
        if route is None:
            return Check("map", "PASS", detail)
        if route.about_home and route.home is None:
            return Check("map", "WARN", f"{detail}; {_HOME_UNTOLD}")
        found = route_on_map(pack, route, route.home, safety)
        seen_by = None if calibration is None else load_camera(calibration)
        too_low = "" if seen_by is None else begins_too_low(pack, seen_by, found.begins_m)
    each = (found.coverage, found.clearance)
    told = (detail, *(one.summary() for one in each), too_low, found.returns)
    verdict: CheckVerdict = "FAIL" if too_low or not all(one.ok for one in each) else "PASS"
    return Check("map", verdict, "; ".join(filter(None, told)))


def _route(path: Path, route_frame: "RouteFrame") -> "tuple[Check, Route | None]":
    """What is wrong with it, if anything; the route where nothing is."""
    from vwnav.geometry.geodesy import LocalFrame
    from vwnav.guidance.plan_files import DEFAULT_HEIGHT_M, load_route

    try:
        route = load_route(path, route_frame)
        frame = LocalFrame(*(route.home or (0.0, 0.0)), 0.0)
        route.to_ned(frame, DEFAULT_HEIGHT_M, route.home_amsl_m)  # refuses what nobody flies
    except VwnavError as error:
        return Check("route", "FAIL", str(error)), None
    return Check("route", "PASS", f"{len(route.waypoints)} waypoints"), route


def _calibration(path: Path) -> Check:
    import math

    from vwnav.geometry.calibration import load_camera, load_findings

    camera = load_camera(path)
    hfov_deg = math.degrees(2.0 * math.atan(camera.width_px / 2.0 / float(camera.K[0, 0])))
    plausible = 20.0 <= hfov_deg <= 150.0
    mount_deg = math.degrees(camera.sigma_mount_rad)
    off_m = 50.0 * math.tan(camera.sigma_mount_rad)
    detail = (
        f"{camera.model}, {camera.width_px}x{camera.height_px}, {hfov_deg:.0f} degrees wide; "
        f"mount taken as known to {mount_deg:.1f} degrees, {off_m:.1f} m on the ground from 50 m"
    )
    found = load_findings(path)
    if "sigma_mount_rpy_deg" not in found:
        detail += ": nobody measured it (vwnav calibrate mount)"
    detail += f"; focal length to {100.0 * camera.sigma_focal_ratio:.1f} %"
    if not {"sigma_fx_px", "sigma_focal_ratio"} & set(found):
        detail += ": nobody measured it (vwnav calibrate camera)"
    detail += f"; dates of pictures to {1e3 * camera.sigma_time_offset_s:.0f} ms"
    if "sigma_time_offset_s" not in found:
        detail += ": nobody measured them, a flight learns them (vwnav calibrate mount)"
    if camera.readout_s is None:
        detail += "; read-out not known: it is learned in the first turns and brakes of a flight"
    return Check("calibration", "PASS" if plausible else "WARN", detail)


def _camera(video: str, calibration: Path | None) -> Check:
    """By what `fly` asks of it before it arms."""
    from vwnav.calibration.held_light import HeldLight
    from vwnav.cameras.live import RealTimeSource
    from vwnav.cameras.modes import mode_of
    from vwnav.cameras.retimed import RetimedSource
    from vwnav.cameras.sources import open_source
    from vwnav.geometry.calibration import load_camera
    from vwnav.safety.readiness import check_camera

    camera = load_camera(calibration) if calibration else None
    offset_s = camera.time_offset_s if camera else 0.0
    mode = camera.sensor_mode if camera else None
    source = open_source(video, mode=mode)
    live = isinstance(source, RealTimeSource)
    try:
        light = HeldLight(source, camera)
        sight, size = _watch(RetimedSource(source, offset_s), camera, live)
        exposure, given = light.in_words(), mode_of(source)
    finally:
        source.close()
    if not live:
        sight = replace(sight, rate_hz=None)
    found = check_camera(sight, sight.image_s or 0.0)
    if found.verdict == "FAIL":
        return found
    rate = "" if sight.rate_hz is None else f"{sight.rate_hz:.1f} a second"
    mode_untold = _MODE_UNTOLD.format(mode) if live and mode and not given else ""
    untold = ("" if live else _KEPT, "" if camera else _FIT_UNTOLD, mode_untold)
    told = "; ".join(filter(None, (found.detail, size, str(given or ""), rate, exposure, *untold)))
    return Check("camera", "WARN" if any(untold) else found.verdict, told)


def _watch(source: "FrameSource", camera: "Camera | None", live: bool) -> "tuple[CameraSight, str]":
    """What its images are like after some seconds, and their size in words.

    Args:
        source: of the images.
        camera: that they should fit; without one the first of them is what the others should fit.
        live: their times are of now.
    """
    from vwnav.onboard.equipment import watch_camera
    from vwnav.safety.camera_watch import CameraSight, CameraWatch

    watch = watch_camera(source, camera) if camera else None
    trouble, good, size = "", 0, ""
    until_s = time.monotonic() + _WATCHED_S
    for _ in range(_WATCHED):
        frame = source.next_frame() if time.monotonic() < until_s else None
        if frame is None:
            break
        height_px, width_px = frame.image.shape[:2]
        size = f"{width_px} x {height_px} px"
        watch = watch or CameraWatch(width_px, height_px)
        told = watch.look(frame, time.monotonic() if live else frame.t_s)
        trouble, good = (told, 0) if told else (trouble, good + 1)
    if watch is None:
        return CameraSight(None), size
    return replace(watch.sight, trouble=trouble if good < _STEADY else ""), size


def _autopilot(url: str, config: "Config") -> list[Check]:
    from vwnav.mavlink.mavsdk_autopilot import MavsdkAutopilot, wait_for_findings
    from vwnav.safety.readiness import check_battery, check_parameters
    from vwnav.watchdog.visitors import visit

    try:
        if next(visit(url), None) is not None:
            return [Check("autopilot", "FAIL", _LINK_TAKEN)]
        autopilot = MavsdkAutopilot(url, system_id=config.flight.autopilot_id)
    except VwnavError as error:
        return [Check("autopilot", "FAIL", str(error))]
    try:
        findings = wait_for_findings(autopilot)
        checks = [Check("autopilot", "PASS", f"{autopilot.kind} on {url}")]
        if autopilot.link_refusal is not None:
            checks.append(Check("link", "FAIL", autopilot.link_refusal))
        checks += check_parameters(findings)
        return [*checks, check_battery(autopilot.state(), config.safety)]
    except VwnavError as error:
        return [Check("autopilot", "FAIL", str(error))]
    finally:
        autopilot.close()


def _print(checks: list[Check], as_json: bool) -> None:
    if as_json:
        print(json.dumps({"checks": [asdict(check) for check in checks]}))
        return
    from rich.console import Console

    from vwnav.screen import check_table

    Console().print(check_table(checks))
