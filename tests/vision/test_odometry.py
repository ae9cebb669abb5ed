"""Odometry on drawn ground: metric, without drift in a hover, and humble where it is not flat."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from vwnav.geometry.camera import Camera
from vwnav.geometry.rotations import rotation_from_euler, rotation_from_vector
from vwnav.types import Frame, OdometryMotion, Rejected, RejectReason
from vwnav.vision.config import OdometryConfig
from vwnav.vision.odometry.odometry import Odometry

LEVEL = np.eye(3)
WIDTH, HEIGHT, AGL_M = 320, 240, 50.0
CAMERA = Camera.from_hfov(WIDTH, HEIGHT, 60.0)
M_PER_PX = AGL_M / float(CAMERA.K[0, 0])


def ground(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    noise = rng.integers(0, 255, (500, 500), dtype=np.uint8)
    return cv2.GaussianBlur(noise, (0, 0), 2.0) * 3


def image(texture, shift_px: float, roof: slice | None = None, roof_gain: float = 2.0):
    """Seen from above after flying north by so many pixels; `roof` columns move faster."""

    def seen(px: float):
        centre = (250.0, 250.0 - px)
        return cv2.getRectSubPix(texture, (WIDTH, HEIGHT), centre)

    out = seen(shift_px)
    if roof is not None:
        out = out.copy()
        out[:, roof] = seen(roof_gain * shift_px)[:, roof]
    return out


def motions(shifts_px, roof=None):
    odometry, texture = Odometry(CAMERA, OdometryConfig()), ground(1)
    results = [
        odometry.step(Frame(0.1 * i, image(texture, px, roof), i), LEVEL, AGL_M)
        for i, px in enumerate(shifts_px)
    ]
    return results[1:]


def test_the_way_is_metric():
    last = motions([0.0, 4.0, 8.0, 12.0])[-1]
    assert isinstance(last, OdometryMotion)
    assert last.displacement_ned_m[0] == pytest.approx(12.0 * M_PER_PX, abs=0.05)
    assert np.abs(last.displacement_ned_m[1:]).max() < 0.1


def exposed(seen: np.ndarray, gain: float | np.ndarray) -> np.ndarray:
    return np.clip(gain * seen, 0, 255).astype(np.uint8)


LIGHTS = {
    "the sun goes in": (1.0, 0.9),
    "an exposure of half": (1.0, 0.5),
    "hunting down": (1.7, 0.4),
    "hunting up": (0.4, 1.7),
    "the shadow of a cloud": (1.0, np.linspace(1.3, 0.3, WIDTH).clip(0.4, 1.0)),
    "that passes": (np.linspace(0.3, 1.3, WIDTH).clip(0.4, 1.0), np.ones(WIDTH)),
}


@pytest.mark.parametrize("light", LIGHTS)
def test_the_way_is_the_same_in_another_light(light):
    """5 % of exposure cost one corner in seven, 20 % half of them; hunting cost the aircraft."""
    seen = [image(ground(1), px) for px in (0.0, 9.0)]
    ways = []
    for gains in ((1.0, 1.0), LIGHTS[light]):
        odometry = Odometry(CAMERA, OdometryConfig())
        shown = [exposed(one, gain) for one, gain in zip(seen, gains, strict=True)]
        ways.append(
            [odometry.step(Frame(0.1 * i, x, i), LEVEL, AGL_M) for i, x in enumerate(shown)]
        )
    steady, way = (each[-1] for each in ways)
    assert isinstance(steady, OdometryMotion)
    assert isinstance(way, OdometryMotion)
    assert way.displacement_ned_m == pytest.approx(steady.displacement_ned_m, abs=0.25 * M_PER_PX)
    assert way.tracks > 0.7 * steady.tracks


def test_a_hover_does_not_drift():
    """Every image is compared with the one keyframe, however long it lasts."""
    swaying = [3.0 * math.sin(0.7 * i) for i in range(60)] + [0.0]
    found = motions(swaying)
    assert all(isinstance(m, OdometryMotion) and m.t0_s == 0.0 for m in found)
    assert np.abs(found[-1].displacement_ned_m).max() < 0.05


def test_a_roof_makes_it_less_sure_and_does_not_pull_it_away():
    flat = motions([0.0, 10.0])[-1]
    roofed = motions([0.0, 10.0], roof=slice(200, WIDTH))[-1]
    assert isinstance(roofed, OdometryMotion)
    assert np.trace(roofed.covariance_ned_m2) > 1.5 * np.trace(flat.covariance_ned_m2)
    error_m = roofed.displacement_ned_m - [10.0 * M_PER_PX, 0.0, 0.0]
    assert np.linalg.norm(error_m[:2]) < 4.0 * math.sqrt(np.trace(roofed.covariance_ned_m2[:2, :2]))


@pytest.mark.parametrize("hfov_deg", [40.0, 70.0, 95.0])
def test_it_says_how_much_of_a_tilt_that_nobody_told_it_takes_for_motion(hfov_deg):
    """The camera tilts by 0.2 degrees about its right axis; told so, and told to be level."""
    camera = Camera.from_hfov(WIDTH, HEIGHT, hfov_deg)
    tilt_rad = math.radians(0.2)
    turn = rotation_from_vector([tilt_rad, 0.0, 0.0])
    still = image(ground(3), 0.0)
    H = camera.K @ turn @ np.linalg.inv(camera.K)
    tilted = cv2.warpPerspective(still, H, (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC)
    R_body_camera = camera.R_body_camera
    found = []
    for R_ned_body in (LEVEL @ R_body_camera @ turn.T @ R_body_camera.T, LEVEL):
        odometry = Odometry(camera, OdometryConfig())
        odometry.step(Frame(0.0, still, 0), LEVEL, AGL_M)
        found.append(odometry.step(Frame(0.1, tilted, 1), R_ned_body, AGL_M))
    told, motion = found
    assert isinstance(told, OdometryMotion)
    assert isinstance(motion, OdometryMotion)
    taken_m = math.dist(told.displacement_ned_m, motion.displacement_ned_m)
    assert taken_m / (AGL_M * tilt_rad) == pytest.approx(motion.tilt_share, abs=0.08)
    assert 0.05 < motion.tilt_share <= 1.0


def test_a_body_that_turns_on_the_spot_goes_nowhere_with_its_camera_on_an_arm():
    """Half a metre ahead, a third aside: the camera swings by 4 cm a frame, the body does not."""
    arm_m, texture = np.array([0.5, -0.35, 0.2]), ground(2)
    camera = replace(CAMERA, t_body_camera_m=arm_m)
    agl_m = 5.0
    m_per_px = (agl_m - arm_m[2]) / float(camera.K[0, 0])
    odometry, found = Odometry(camera, OdometryConfig()), []
    for i in range(3):
        R = rotation_from_euler(0.0, 0.0, 0.07 * i)
        north, east = (R @ arm_m)[:2] / m_per_px
        c, s = R[0, 0], R[1, 0]
        u0, v0 = 250.0 + east, 250.0 - north
        half = (np.array([WIDTH, HEIGHT]) - 1.0) / 2.0
        H_ground_frame = np.array(
            [[c, -s, u0 - c * half[0] + s * half[1]], [s, c, v0 - s * half[0] - c * half[1]]]
        )
        flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
        image = cv2.warpAffine(texture, H_ground_frame, (WIDTH, HEIGHT), flags=flags)
        found.append(odometry.step(Frame(0.1 * i, image, i), R, agl_m))
    assert isinstance(found[-1], OdometryMotion)
    assert np.abs(found[-1].displacement_ned_m).max() < 0.01
    assert found[-1].agl_m == agl_m


@pytest.mark.parametrize(
    ("half_turns", "least", "most"), [(0, 5.0, math.inf), (1, -math.inf, -15.0)]
)
def test_an_upright_camera_tilts_as_the_aircraft_does_and_one_upside_down_the_other_way(
    half_turns, least, most
):
    """The aircraft rolls by one degree on the spot, and its attitudes say so."""
    roll = rotation_from_vector([math.radians(1.0), 0.0, 0.0])
    still = image(ground(3), 0.0)
    R_camera0_camera1 = CAMERA.R_body_camera.T @ roll @ CAMERA.R_body_camera
    H = CAMERA.K @ R_camera0_camera1.T @ np.linalg.inv(CAMERA.K)
    rolled = cv2.warpPerspective(still, H, (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC)
    odometry = Odometry(CAMERA, OdometryConfig())
    seen = [np.ascontiguousarray(np.rot90(each, 2 * half_turns)) for each in (still, rolled)]
    odometry.step(Frame(0.0, seen[0], 0), LEVEL, AGL_M)
    motion = odometry.step(Frame(0.1, seen[1], 1), roll, AGL_M)
    assert isinstance(motion, OdometryMotion)
    assert least < motion.tilts_along < most


@pytest.mark.parametrize("quarters", [1, 2, 3])
@pytest.mark.parametrize("axis", [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.7, -0.7, 0.0]])
def test_of_a_camera_that_is_turned_on_its_mount_images_show_by_how_much(quarters, axis):
    """The aircraft tilts by one degree; the camera hangs turned clockwise from how it is told."""
    tilt = rotation_from_vector(math.radians(1.0) * np.array(axis))
    still = image(ground(3), 0.0)
    H = (
        CAMERA.K
        @ (CAMERA.R_body_camera.T @ tilt.T @ CAMERA.R_body_camera)
        @ np.linalg.inv(CAMERA.K)
    )
    tilted = cv2.warpPerspective(still, H, (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC)
    turn = rotation_from_vector([0.0, 0.0, -0.5 * math.pi * quarters])
    odometry = Odometry(
        replace(CAMERA, R_body_camera=turn @ CAMERA.R_body_camera), OdometryConfig()
    )
    odometry.step(Frame(0.0, still, 0), LEVEL, AGL_M)
    motion = odometry.step(Frame(0.1, tilted, 1), tilt, AGL_M)
    assert isinstance(motion, OdometryMotion)
    ratios = [motion.tilts_along, *motion.tilts_turned[:3]]
    assert int(np.argmax(ratios)) == quarters
    assert ratios[quarters] > 5.0


@pytest.mark.parametrize("quarters", [0, 1])
@pytest.mark.parametrize("heading_deg", [0.0, 50.0, 200.0])
def test_mirrored_images_show_tilts_as_no_camera_does_however_it_is_turned(heading_deg, quarters):
    """The aircraft tilts by one degree, about one axis and another; its camera may hang turned."""
    heading = rotation_from_vector([0.0, 0.0, math.radians(heading_deg)])
    hangs = rotation_from_vector([0.0, 0.0, 0.5 * math.pi * quarters]) @ CAMERA.R_body_camera
    still, ratios = image(ground(3), 0.0), np.zeros(6)
    for axis in ([1.0, 0.3, 0.0], [-0.3, 1.0, 0.0]):
        tilt = rotation_from_vector(math.radians(1.0) * np.array(axis))
        H = CAMERA.K @ (hangs.T @ tilt.T @ hangs) @ np.linalg.inv(CAMERA.K)
        tilted = cv2.warpPerspective(still, H, (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC)
        seen = [np.ascontiguousarray(each[:, ::-1]) for each in (still, tilted)]
        odometry = Odometry(CAMERA, OdometryConfig())
        odometry.step(Frame(0.0, seen[0], 0), heading, AGL_M)
        motion = odometry.step(Frame(0.1, seen[1], 1), heading @ tilt, AGL_M)
        assert isinstance(motion, OdometryMotion)
        ratios += [motion.tilts_along, *motion.tilts_turned]
    assert int(np.argmax(ratios)) == 4 + quarters
    assert ratios[4 + quarters] > max(*ratios[:4], 0.0) + 10.0


def test_a_heading_that_the_autopilot_resets_is_no_tilting_that_the_image_does_not_show():
    """The aircraft leans and moves nowhere; its attitude jumps by 20 degrees about the vertical."""
    leaning = rotation_from_vector([math.radians(10.0), 0.0, 0.0])
    reset = rotation_from_vector([0.0, 0.0, math.radians(20.0)]) @ leaning
    still, odometry = image(ground(3), 0.0), Odometry(CAMERA, OdometryConfig())
    odometry.step(Frame(0.0, still, 0), leaning, AGL_M)
    motion = odometry.step(Frame(0.1, still, 1), reset, AGL_M)
    assert isinstance(motion, OdometryMotion)
    assert abs(motion.tilts_along) < 1.0


@pytest.mark.parametrize("knock_deg", [-45.0, -30.0, 20.0, 35.0, 50.0])
def test_a_camera_that_is_knocked_round_shows_a_turn_and_the_way(knock_deg):
    """Between two images it is turned clockwise on its mount; the aircraft flies on northward."""

    def knocked(px: float) -> np.ndarray:
        turn = cv2.getRotationMatrix2D((250.0, 250.0 - px), knock_deg, 1.0)
        seen = cv2.warpAffine(ground(1), turn, (500, 500), flags=cv2.INTER_CUBIC)
        return cv2.getRectSubPix(seen, (WIDTH, HEIGHT), (250.0, 250.0 - px))

    odometry = Odometry(CAMERA, OdometryConfig())
    images = [image(ground(1), 0.0), image(ground(1), 4.0), knocked(8.0), knocked(12.0)]
    _, _, at_once, after = [
        odometry.step(Frame(0.1 * i, each, i), LEVEL, AGL_M) for i, each in enumerate(images)
    ]
    assert isinstance(at_once, OdometryMotion)
    assert abs(math.degrees(at_once.yaw_increment_rad)) == pytest.approx(abs(knock_deg), abs=0.5)
    step_m = (at_once.t1_s - at_once.t0_s) / 0.1 * 4.0 * M_PER_PX
    assert at_once.displacement_ned_m[0] == pytest.approx(step_m, abs=0.15)
    assert isinstance(after, OdometryMotion)
    assert after.t0_s >= at_once.t1_s - 1e-9
    assert abs(math.degrees(after.yaw_increment_rad)) < 0.5


def test_what_was_mistaken_is_followed_no_further_and_the_newest_image_is():
    odometry = Odometry(CAMERA, OdometryConfig())
    images = [image(ground(1), px) for px in (0.0, 4.0, 8.0)]
    odometry.step(Frame(0.0, images[0], 0), LEVEL, AGL_M)
    odometry.step(Frame(0.1, images[1], 1), LEVEL, AGL_M)
    odometry.mistook()
    motion = odometry.step(Frame(0.2, images[2], 2), LEVEL, AGL_M)
    assert isinstance(motion, OdometryMotion)
    assert motion.t0_s == 0.1


def looks_of(images, tilts_deg):
    """What odometry says of each image, five a second, of a body that leans forward by so much."""
    odometry = Odometry(CAMERA, OdometryConfig())
    return [
        odometry.step(
            Frame(0.2 * i, shown, i), rotation_from_euler(0.0, math.radians(tilt_deg), 0.0), AGL_M
        )
        for i, (shown, tilt_deg) in enumerate(zip(images, tilts_deg, strict=True))
    ]


def noisy(count: int, shaken_px: float = 0.0, flicker: float = 0.0) -> list[np.ndarray]:
    """One picture again and again, as a stream encodes it anew: no two are the same."""
    rng, shown = np.random.default_rng(3), image(ground(1), 0.0).astype(np.float64)
    made = []
    for _ in range(count):
        M = np.column_stack([np.eye(2), rng.normal(0.0, shaken_px, 2)])
        one = cv2.warpAffine(shown, M, shown.shape[::-1], borderMode=cv2.BORDER_REFLECT)
        one = (1.0 + flicker * rng.normal()) * one + rng.normal(0.0, 4.0, shown.shape)
        made.append(np.clip(one, 0, 255).astype(np.uint8))
    return made


def is_none(look) -> bool:
    return isinstance(look, Rejected) and look.reason is RejectReason.NO_FRAME


def test_a_picture_that_stands_still_while_the_aircraft_turns_is_none_whatever_its_noise():
    """A hover was believed on one for a minute: 18 m wrong, 37 sigmas."""
    tilts_deg = [0.6 * math.sin(0.8 * i) for i in range(24)]
    frozen = looks_of(noisy(24), tilts_deg)
    assert not any(map(is_none, frozen[:5]))  # it takes a second
    assert all(map(is_none, frozen[12:]))
    for turned_deg in (0.0, 25.0):  # it hangs for as long as it does, however it turns by then
        leans = [2.0 * each + turned_deg * (i > 15) for i, each in enumerate(tilts_deg)]
        assert all(map(is_none, looks_of(noisy(24), leans)[12:]))
    live = [image(ground(1), px) for px in (4.0, 8.0)]
    after = looks_of([*noisy(20), *live], [*tilts_deg[:20], 0.0, 0.0])
    assert isinstance(after[-1], OdometryMotion)


def test_nor_is_it_one_that_is_shaken_and_flickers():
    """Half a pixel of 640 was enough to be believed: 57 m off, 12 sigmas."""
    tilts_deg = [1.5 * math.sin(0.8 * i) for i in range(24)]
    assert all(map(is_none, looks_of(noisy(24, shaken_px=0.25, flicker=0.05), tilts_deg)[14:]))


def test_nor_is_it_one_whose_exposure_hunts():
    """Nothing of it could be followed: its fixes were believed as it landed, 93 m off."""
    tilts_deg = [0.6 * math.sin(0.8 * i) for i in range(24)]
    hunting = [exposed(one, (0.4, 1.7)[i % 2]) for i, one in enumerate(noisy(24))]
    assert all(map(is_none, looks_of(hunting, tilts_deg)[12:]))


def test_nor_is_it_one_that_had_moved_while_it_lived():
    """By 0.8 px before it froze, in a hover: 12 s of nothing were believed, 8 sigmas."""
    tilts_deg = [0.35 * math.sin(0.8 * i) for i in range(40)]
    px = [-math.tan(math.radians(t)) * AGL_M / M_PER_PX for t in tilts_deg]
    live = [image(ground(1), 0.5 * each) for each in px[:11]]
    looks = looks_of([*live, *noisy(29)], tilts_deg)
    assert not any(map(is_none, looks[:11]))
    assert all(map(is_none, looks[24:]))


def test_a_hover_is_no_picture_that_stands_still():
    """In still air one is: it does not turn. And what turns sees the ground move."""
    assert not any(map(is_none, looks_of(noisy(24), 24 * [0.3])))
    tilts_deg = [0.6 * math.sin(0.8 * i) for i in range(24)]
    px = [-math.tan(math.radians(t)) * AGL_M / M_PER_PX for t in tilts_deg]
    assert not any(map(is_none, looks_of([image(ground(1), each) for each in px], tilts_deg)))


def test_nor_is_a_narrow_view_that_turns_about_its_axis():
    """A third of a degree is a pixel at the rim of its image, and five were it to lean so."""
    camera, shown = Camera.from_hfov(WIDTH, HEIGHT, 20.0), image(ground(1), 0.0)
    odometry, looks = Odometry(camera, OdometryConfig()), []
    for i in range(24):
        yaw_deg = 0.3 * math.sin(0.8 * i)
        M = cv2.getRotationMatrix2D(((WIDTH - 1) / 2.0, (HEIGHT - 1) / 2.0), yaw_deg, 1.0)
        one = cv2.warpAffine(shown, M, (WIDTH, HEIGHT), borderMode=cv2.BORDER_REFLECT)
        R_ned_body = rotation_from_euler(0.0, 0.0, math.radians(yaw_deg))
        looks.append(odometry.step(Frame(0.2 * i, one, i), R_ned_body, AGL_M))
    assert not any(map(is_none, looks))
