"""All that is known of a flight before the link is opened: files read, route over the map."""

from contextlib import ExitStack
from pathlib import Path

from vwnav.assemble import choose_features, warm, with_map
from vwnav.config import load_config, with_camera, with_features
from vwnav.errors import PreflightError
from vwnav.geometry.calibration import load_camera
from vwnav.geometry.geodesy import LocalFrame, parse_lat_lon
from vwnav.guidance.plan_files import DEFAULT_HEIGHT_M, load_route
from vwnav.maps.pack import MapPack
from vwnav.onboard.flight_plan import FlightPlan
from vwnav.onboard.options import FlyOptions
from vwnav.onboard.simulation import DEFAULT_SITE, map_pack_of
from vwnav.screen import say
from vwnav.sim.named_sites import is_site, parse_site
from vwnav.sim.renderer import default_camera
from vwnav.types import FeatureExtractor


def plan_flight(options: FlyOptions, stack: ExitStack) -> FlightPlan:
    """All that is known before the link is opened.

    Raises:
        VwnavError: a file that cannot be used, or a pack of another model's features.
        PreflightError: the map does not cover the route, or has ground that is too high for it.
    """
    config = with_features(load_config(options.config_path), options.features, options.model)
    assert options.route is not None
    route = load_route(options.route, "global" if options.route_frame == "global" else "local")
    camera = load_camera(options.camera) if options.camera else default_camera()
    config = with_camera(
        config, camera.sigma_mount_rad, camera.sigma_focal_ratio, camera.sigma_time_offset_s
    )
    features = choose_features(config.features, say)
    pack = stack.enter_context(MapPack.open(_map_path(options, features)))
    config = with_map(config, pack)
    home = parse_lat_lon(options.home) if options.home else route.home
    if home is None and options.sim:
        site = parse_site(options.video or DEFAULT_SITE)
        home = (site.home_lat_deg, site.home_lon_deg)
    home_lat, home_lon = home or pack.middle
    surveyed_m = pack.elevation_m(home_lat, home_lon)
    local_frame = LocalFrame(home_lat, home_lon, surveyed_m or 0.0)
    ground_m = route.ground_amsl_m(home, surveyed_m)
    route_ned_m = route.to_ned(local_frame, DEFAULT_HEIGHT_M, ground_m)
    plan = FlightPlan(
        config, pack, camera, local_frame, route_ned_m, home is not None, options.home_sigma_m,
        route.about_home, features,
    )  # fmt: skip
    refused = plan.refuse_at_once()
    if refused:
        raise PreflightError(refused)
    pack.check_features(features[0])
    warm(features[0], config.localizer)
    return plan


def _map_path(
    options: FlyOptions, features: tuple[FeatureExtractor, FeatureExtractor | None]
) -> Path:
    text = str(options.map_source)
    if not is_site(text):
        return Path(text)
    return map_pack_of(text, [each for each in features if each is not None])
