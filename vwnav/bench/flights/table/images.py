"""Images that tell nothing, tell it badly, late or seldom."""

from vwnav.bench.flights.faults import camera as broken
from vwnav.bench.flights.faults import fixes, light, sensor
from vwnav.bench.flights.faults.aircraft import StationOrders
from vwnav.bench.flights.scenario import (
    BREAKS_AT_S,
    CONFIG,
    HOME,
    RETURN,
    Break,
    Ending,
    Scenario,
    down,
    flies_on,
    phase,
    said,
    setup,
)
from vwnav.config import with_camera
from vwnav.geometry.camera import (
    UNMEASURED_FOCAL_RATIO,
    UNMEASURED_MOUNT_RAD,
    UNMEASURED_OFFSET_S,
)
from vwnav.vehicle import Order

UNMEASURED = with_camera(CONFIG, UNMEASURED_MOUNT_RAD, UNMEASURED_FOCAL_RATIO, UNMEASURED_OFFSET_S)
USELESS = [
    Scenario(
        name=f"pictures {name} for good at 50 m",
        setup=setup(wind_m_s=5.0),
        breaks=(Break(fault=broken.CameraTrouble(make), at_s=BREAKS_AT_S),),
        limit_s=75.0,
        follows=(phase(8.0, "landing"), down(60.0)),
        lands_within_m=50.0,
    )
    for name, make in (
        ("gone", broken.no_images),
        ("black", broken.black),
        ("frozen", broken.frozen),
        ("frozen in a stream", broken.frozen_in_a_stream),
        ("failing", broken.raising),
        ("over-exposed", light.overexposed),
        ("of another size", broken.another_size),
        ("of one second in a loop", broken.looping),
        ("of a ground that repeats", broken.repeating_ground),
    )
]
FROZEN = [
    # It hangs on what it sees: the aircraft may drift as it likes, and no way contradicts the IMU.
    Scenario(
        name="the ground station pauses the flight, and pictures freeze in a stream",
        setup=setup(),
        breaks=(
            Break(fault=StationOrders(Order.PAUSE), at_s=4.0),
            Break(fault=broken.CameraTrouble(broken.frozen_in_a_stream), at_s=12.0),
        ),
        limit_s=90.0,
        follows=(said(16.0, "they stand still while the aircraft turns"), phase(24.0, "landing")),
        lands_within_m=50.0,
    ),
    # Nothing can be followed, and now and then one is found on the map, where it froze.
    Scenario(
        name="pictures frozen in a stream whose exposure hunts for good at 50 m",
        setup=setup(wind_m_s=5.0),
        breaks=tuple(
            Break(fault=broken.CameraTrouble(make), at_s=BREAKS_AT_S)
            for make in (broken.frozen_in_a_stream, light.exposure_hunting)
        ),
        limit_s=75.0,
        follows=(phase(8.0, "landing"), down(60.0)),
        lands_within_m=50.0,
    ),
]
POOR = [
    flies_on(f"pictures {name} for 15 s", broken.CameraTrouble(make), 15.0)
    for name, make in (
        ("with the sun's glare", light.sun_glare),
        ("half covered", broken.half_covered),
        ("out of focus", broken.out_of_focus),
        ("dropped in bursts", broken.bursts_dropped),
        ("with the landing gear in view", broken.landing_gear),
        ("through drops on the lens", broken.drops),
        ("at dusk", light.dusk),
        ("whose exposure hunts", light.exposure_hunting),
        ("of which each comes twice", broken.each_twice),
        ("with times that cannot be", broken.false_times),
        ("torn by a bad cable", broken.torn),
        ("cut off by a bad cable", broken.smeared),
        ("in fog", light.fog),
        ("under shadows of clouds", light.cloud_shadows),
        ("of a mount that vibrates", sensor.jello),
        ("whose focus hunts", sensor.focus_hunting),
        ("compressed hard", sensor.compressed),
        ("of little light and much gain", sensor.fixed_pattern),
    )
]
# Images alone tell the way, in a light that does not stay as it is.
WITHOUT_FIXES = [
    Scenario(
        name=f"no fix for 12 s, pictures {how}",
        setup=setup(),
        breaks=tuple(
            Break(fault=fault, at_s=BREAKS_AT_S, for_s=12.0)
            for fault in (fixes.NoFixes(), broken.CameraTrouble(make))
        ),
        limit_s=45.0,
        ending=Ending.FLIES_ON,
    )
    for how, make in (
        ("whose exposure hunts", light.exposure_hunting),
        ("whose exposure follows the light", light.exposure_following),
        ("under shadows of clouds", light.cloud_shadows),
        ("of a mount that vibrates", sensor.jello),
        ("compressed hard", sensor.compressed),
        ("of little light and much gain", sensor.fixed_pattern),
    )
]
LATE = [
    flies_on("pictures 0.5 s late", broken.ImagesLate(0.5), 15.0),
    flies_on("pictures 0.5 s late, stamped on arrival", broken.ImagesLate(0.5, False), 15.0),
    Scenario(
        name="5 pictures a second",
        setup=setup(image_hz=5.0),
        breaks=(),
        limit_s=40.0,
        ending=Ending.FLIES_ON,
    ),
    flies_on("pictures gone for 3 s", broken.CameraTrouble(broken.no_images), 3.0, 13.0),
    flies_on("pictures gone for 5 s", broken.CameraTrouble(broken.no_images), 5.0, 13.0),
]
MOUNTED = [
    Scenario(
        name="camera with a mirrored picture",
        setup=setup(None),
        breaks=(Break(fault=broken.CameraTrouble(broken.mirrored), at_s=0.0),),
        limit_s=260.0,
        follows=(said(40.0, "mirrors its pictures"),),
        lands_within_m=3.0,
        lands_at_ne_m=HOME,
    ),
    *(
        Scenario(
            name=f"camera gone for 2 s, and then its pictures {how}",
            setup=setup(),
            breaks=(
                Break(fault=broken.CameraTrouble(broken.no_images), at_s=BREAKS_AT_S, for_s=2.0),
                Break(fault=broken.CameraTrouble(make), at_s=BREAKS_AT_S + 2.0),
            ),
            limit_s=50.0,
            ending=Ending.FLIES_ON,
            follows=(said(6.0, words),),
        )
        for how, make, words in (
            ("mirrored", broken.mirrored, "mirrors its pictures"),
            ("upside down", broken.upside_down, "hangs turned by 180 degrees"),
            ("of another mode", broken.cropped, "times as wide as its calibration"),
            ("stabilised", broken.stabilised, "times as wide as its calibration"),
        )
    ),
    *(
        Scenario(
            name=f"pictures {how} in flight",
            setup=setup(),
            breaks=(Break(fault=broken.CameraTrouble(make), at_s=BREAKS_AT_S),),
            limit_s=50.0,
            ending=Ending.FLIES_ON,
            follows=(said(3.0, "times as wide as its calibration"),),
        )
        for how, make in (
            ("zoomed in by a third", broken.zoomed_in),
            ("stabilised by a tenth", broken.stabilised),
        )
    ),
    Scenario(
        name="camera mounted upside down",
        setup=setup(None),
        breaks=(Break(fault=broken.CameraTrouble(broken.upside_down), at_s=0.0),),
        limit_s=260.0,
        follows=(said(40.0, "hangs turned by 180 degrees"), phase(60.0, "on route")),
        lands_within_m=2.0,
        lands_at_ne_m=HOME,
    ),
    *(
        Scenario(
            name=f"camera turned by {degrees:.0f} degrees",
            setup=setup(None, mount_off_deg=(0.0, 0.0, degrees)),
            breaks=(),
            limit_s=260.0,
            follows=(said(60.0, "hangs turned by"), phase(60.0, "on route")),
            lands_within_m=2.0,
            lands_at_ne_m=HOME,
        )
        for degrees in (10.0, 45.0, 90.0, 270.0)
    ),
    Scenario(
        name="camera hung 6 degrees round by hand",
        setup=setup(None, mount_off_deg=(0.0, 0.0, 6.0)),
        breaks=(),
        limit_s=260.0,
        lands_within_m=2.0,
        lands_at_ne_m=HOME,
    ),
    Scenario(
        name="camera hung sideways, as calibrated",
        setup=setup(None, mount_yaw_deg=90.0),
        breaks=(),
        limit_s=260.0,
        follows=(phase(60.0, "on route"),),
        lands_within_m=2.0,
        lands_at_ne_m=HOME,
    ),
    Scenario(
        name="camera hung 3 degrees nose up by hand",
        setup=setup(None, mount_off_deg=(0.0, 3.0, 0.0), config=UNMEASURED),
        breaks=(),
        limit_s=260.0,
        lands_within_m=2.0,
        lands_at_ne_m=HOME,
    ),
    *(
        Scenario(
            name=f"a lens {name} than its data sheet says",
            setup=setup(None, lens_ratio=ratio, config=UNMEASURED),
            breaks=(),
            limit_s=260.0,
            lands_within_m=2.0,
            lands_at_ne_m=HOME,
        )
        for name, ratio in (("5 % wider", 0.95), ("5 % narrower", 1.05))
    ),
    *(
        Scenario(
            name=f"a lens a fifth {name} than calibrated",
            setup=setup(None, lens_ratio=ratio),
            breaks=(),
            limit_s=260.0,
            follows=(said(60.0, "times as wide as its calibration says"),),
            lands_within_m=2.0,
            lands_at_ne_m=HOME,
        )
        for name, ratio in (("wider", 0.8), ("narrower", 1.25))
    ),
    Scenario(
        name="camera 1 m ahead of the autopilot, 0.8 m to its left, 0.2 m below",
        setup=setup(RETURN, arm_m=(1.0, -0.8, 0.2)),
        breaks=(),
        limit_s=110.0,
        lands_within_m=0.6,
        lands_at_ne_m=HOME,
    ),
]
KNOCKED = [
    Scenario(
        name=f"camera knocked in flight, {how}",
        setup=setup(),
        breaks=(Break(fault=broken.CameraKnocked(off_deg), at_s=15.0),),
        limit_s=160.0,
        follows=told,
        lands_within_m=2.0,
        lands_at_ne_m=HOME,
    )
    for how, off_deg, told in (
        (
            "8 degrees nose up",
            (0.0, 8.0, 0.0),
            (said(5.0, "the camera hangs otherwise"), said(30.0, "further ahead than its mount")),
        ),
        (
            "12 degrees to the right",
            (-12.0, 0.0, 0.0),
            (said(5.0, "the camera hangs otherwise"), said(30.0, "further right than its mount")),
        ),
        ("round by 20 degrees", (0.0, 0.0, 20.0), (said(5.0, "hangs turned by"),)),
        (
            "round by 45 degrees",
            (0.0, 0.0, 45.0),
            (said(5.0, *(f"turned by {about} degrees clockwise" for about in (44, 45, 46))),),
        ),
        ("round by 90 degrees", (0.0, 0.0, 90.0), (said(5.0, "turned by 90 degrees clockwise"),)),
        (
            "round by 15 and aslant by 5",
            (-3.0, 4.0, 15.0),
            (said(5.0, "degrees clockwise, seen"), said(30.0, "further ahead and right")),
        ),
        (
            "round by 30 and aslant by 8",
            (0.0, 8.0, 30.0),
            (said(5.0, "degrees clockwise, seen"), said(30.0, "further ahead and right")),
        ),
    )
]
IMAGES = [*USELESS, *FROZEN, *POOR, *WITHOUT_FIXES, *LATE, *MOUNTED, *KNOCKED]
