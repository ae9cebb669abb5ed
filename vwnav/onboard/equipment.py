"""Camera and truth of a flight, as the options name them."""

from collections.abc import Callable
from contextlib import ExitStack

from vwnav.cameras.light.keeper import HoldsExposure
from vwnav.cameras.modes import trouble_with_mode
from vwnav.cameras.retimed import RetimedSource
from vwnav.cameras.sources import open_source
from vwnav.clock import Clock
from vwnav.errors import LinkError
from vwnav.geometry.camera import Camera
from vwnav.geometry.exposure import BlurLimit
from vwnav.mavlink.links import parse_link
from vwnav.onboard.flight_plan import FlightPlan
from vwnav.onboard.options import FlyOptions
from vwnav.onboard.simulation import draw_site
from vwnav.safety.camera_watch import CameraWatch
from vwnav.seams import FrameSource
from vwnav.sim.camera_source import SimulatedCamera
from vwnav.sim.named_sites import is_site, parse_site
from vwnav.sim.renderer import CameraRenderer
from vwnav.sim.truth import TruthReader
from vwnav.vehicle import Navigation


def open_truth(
    url: str | None, link: str, observer_url: str, clock: Clock, stack: ExitStack
) -> TruthReader | None:
    """Ground truth of a simulator; through the watchdog where it comes on the autopilot's link."""
    if url is None:
        return None
    if is_same_link(url, link):
        url = observer_url
    truth = TruthReader(url, clock=clock)
    stack.callback(truth.close)
    return truth


def is_same_link(truth_url: str, link: str) -> bool:
    """Whether the truth comes on the port of the autopilot's own link, which has one owner."""
    scheme, _, rest = truth_url.partition(":")
    try:
        truth = parse_link(f"{scheme}://{rest.removeprefix('//')}")
    except LinkError:
        return False  # the reader of the truth says what is wrong with it
    return truth.is_same_port(parse_link(link))


def draw_camera(options: FlyOptions, plan: FlightPlan, stack: ExitStack) -> CameraRenderer | None:
    """What a simulated camera is drawn with; None for a real one."""
    video = str(options.video)
    if not is_site(video):
        return None
    height_m = -float(plan.route_ned_m[0, 2])
    return draw_site(video, plan.camera, plan.route_lat_lon_deg, height_m, options.seed, stack)


def open_camera(
    options: FlyOptions,
    plan: FlightPlan,
    renderer: CameraRenderer | None,
    truth: TruthReader | None,
    clock: Clock,
    stack: ExitStack,
    flown_m: float | None = None,
) -> FrameSource:
    """The camera, with its calibrated time offset, or one drawn from a simulator's truth.

    `flown_m` is how high the vehicle flies already, None on the ground: in the air a camera that is
    not there is waited for, and the ground that is drawn lies so far below.
    """
    source: FrameSource
    if renderer is None:
        source = open_source(
            str(options.video), mode=plan.camera.sensor_mode, at_once=flown_m is None
        )
        if plan.camera.time_offset_s:
            source = RetimedSource(source, plan.camera.time_offset_s)
    else:
        assert truth is not None
        site = parse_site(str(options.video))
        home = (site.home_lat_deg, site.home_lon_deg)
        source = SimulatedCamera(renderer, truth, home, clock, flown_m or 0.0)
    stack.callback(source.close)
    return source


def watch_camera(source: FrameSource, camera: Camera) -> CameraWatch:
    """Looks at each image of a source, whether it fits the calibration."""
    return CameraWatch(camera.width_px, camera.height_px, lambda: trouble_with_mode(source, camera))


def hold_exposure(
    source: FrameSource,
    plan: FlightPlan,
    navigation: Callable[[], Navigation],
    say: Callable[[str], None],
) -> None:
    """Have a live camera expose no longer than what is flown allows."""
    if isinstance(source, HoldsExposure):
        lowest_m = -float(plan.route_ned_m[:, 2].max())
        limit = BlurLimit(plan.camera.K[0, 0], plan.config.limits.cruise_m_s, lowest_m)
        source.hold_exposure(lambda: limit.most_s(navigation().estimate), say)
