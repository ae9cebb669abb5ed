"""Pictures that tell nothing, tell it badly, late or seldom."""

from vwnav.bench.flights.faults import camera as broken
from vwnav.bench.flights.scenario import (
    BREAKS_AT_S,
    Break,
    Ending,
    Scenario,
    down,
    flies_on,
    phase,
    said,
    setup,
)

_NOTICED_S = 8.0
_NOTICED_BRAKING_S = 15.0  # its ways look right until it slows down, for want of fixes, after 8 s
USELESS = [
    Scenario(
        name=f"pictures {name} for good at 50 m",
        setup=setup(wind_m_s=5.0),
        breaks=(Break(fault=broken.CameraTrouble(make), at_s=BREAKS_AT_S),),
        limit_s=75.0,
        follows=(phase(lands_s, "landing"), down(60.0)),
        lands_within_m=50.0,
    )
    for name, make, lands_s in (
        ("gone", broken.no_pictures, _NOTICED_S),
        ("black", broken.black, _NOTICED_S),
        ("frozen", broken.frozen, _NOTICED_S),
        ("failing", broken.raising, _NOTICED_S),
        ("over-exposed", broken.overexposed, _NOTICED_S),
        ("of another size", broken.another_size, _NOTICED_S),
        ("of one second in a loop", broken.looping, _NOTICED_S),
        ("of a ground that repeats", broken.repeating_ground, _NOTICED_BRAKING_S),
    )
]
POOR = [
    flies_on(f"pictures {name} for 15 s", broken.CameraTrouble(make), 15.0)
    for name, make in (
        ("with the sun's glare", broken.sun_glare),
        ("half covered", broken.half_covered),
        ("out of focus", broken.out_of_focus),
        ("dropped in bursts", broken.bursts_dropped),
    )
]
LATE = [
    flies_on("pictures 0.5 s late", broken.PicturesLate(0.5), 15.0),
    flies_on("pictures 0.5 s late, stamped on arrival", broken.PicturesLate(0.5, False), 15.0),
    Scenario(
        name="5 pictures a second",
        setup=setup(picture_hz=5.0),
        breaks=(),
        limit_s=40.0,
        ending=Ending.FLIES_ON,
    ),
    flies_on("pictures gone for 3 s", broken.CameraTrouble(broken.no_pictures), 3.0, 13.0),
]
MOUNTED = [
    Scenario(
        name="camera mounted upside down",
        setup=setup(None),
        breaks=(Break(fault=broken.CameraTrouble(broken.upside_down), at_s=0.0),),
        limit_s=140.0,
        follows=(said(40.0, "contradicts the IMU"), down(80.0)),
        lands_within_m=50.0,
    ),
]
PICTURES = [*USELESS, *POOR, *LATE, *MOUNTED]
