"""Bad days: several things at once, and what breaks again and again."""

import math
from typing import Any

from vwnav.bench.flights.faults import aircraft, camera, computer, fixes, light, link
from vwnav.bench.flights.scenario import (
    BREAKS_AT_S,
    DESCEND,
    HOME,
    NOBODY_KNOWS,
    Break,
    Ending,
    Scenario,
    again_and_again,
    down,
    phase,
    said,
    setup,
    unsaid,
)
from vwnav.bench.flights.stage import Fault
from vwnav.bench.flights.table.link import STAY_UP, with_action
from vwnav.mission.mission import Phase

_STORM_M_S, _GUSTS_M_S = 12.0, 3.0
_A_THIRD = computer.Starved(0.33, 1000.0)


def _flown_through(name: str, breaks: tuple[Break, ...], wind_m_s: float = 4.0) -> Scenario:
    gusts_m_s = _GUSTS_M_S if wind_m_s == _STORM_M_S else None
    return Scenario(
        name=name,
        setup=setup(wind_m_s=wind_m_s, gust_m_s=gusts_m_s),
        breaks=breaks,
        limit_s=45.0,
        ending=Ending.FLIES_ON,
    )


def _at_once(*faults: Fault, for_s: float | None = 20.0) -> tuple[Break, ...]:
    return tuple(Break(fault=each, at_s=BREAKS_AT_S, for_s=for_s) for each in faults)


LOOSE = [
    _flown_through(
        "a loose link: gone for 0.8 s of every 3 s", again_and_again(link.LinkCut(), 3.0, 0.8, 8)
    ),
    _flown_through(
        "a loose camera: gone for 2 s of every 4 s",
        again_and_again(camera.CameraTrouble(camera.no_images), 4.0, 2.0, 7),
    ),
    _flown_through(
        "a model that raises for 1 s of every 2 s",
        again_and_again(computer.ModelRaises(), 2.0, 1.0, 12),
    ),
    _flown_through(
        "a navigator stopped for 0.4 s of every 2 s",
        again_and_again(computer.NavigatorStopped(0.4), 2.0, None, 12),
    ),
    _flown_through(
        "a watchdog killed three times", again_and_again(computer.WatchdogKilled(), 6.0, None, 3)
    ),
]
STORM = [
    _flown_through(
        "a storm, pictures 0.5 s late, a fifth of the packets lost",
        _at_once(camera.ImagesLate(0.5), link.PacketsLost(0.2)),
        _STORM_M_S,
    ),
    _flown_through(
        "a storm, the sun's glare, a third of the processor",
        (
            Break(fault=_A_THIRD, at_s=0.0),
            *_at_once(camera.CameraTrouble(light.sun_glare)),
        ),
        _STORM_M_S,
    ),
    _flown_through(
        "a storm, pictures gone for 3 s, a round trip of 0.3 s",
        (
            Break(fault=link.RoundTrip(0.3), at_s=4.0),
            *_at_once(camera.CameraTrouble(camera.no_images), for_s=3.0),
        ),
        _STORM_M_S,
    ),
]
BOTH_HANDS = [
    Scenario(
        name=f"pilot takes over {while_what}",
        setup=setup(rc_on=True),
        breaks=(
            Break(fault=fault, at_s=BREAKS_AT_S, for_s=for_s),
            Break(fault=aircraft.PilotSwitches(), at_s=BREAKS_AT_S + 2.7),
        ),
        limit_s=35.0,
        ending=Ending.PILOT,
    )
    for while_what, fault, for_s in (
        ("while the link is cut", link.LinkCut(), 5.0),
        ("while the lens is covered", camera.CameraTrouble(camera.black), None),
        ("after the navigator was killed", computer.NavigatorKilled(), None),
        ("while the watchdog hangs", computer.WatchdogHangs(), None),
    )
]
BLIND = [
    Scenario(
        name="dust covers the lens as it lands",
        setup=setup(DESCEND, wind_m_s=5.0),
        breaks=(Break(fault=camera.CameraTrouble(camera.black), at_s=0.0, phase=Phase.LAND),),
        limit_s=100.0,
        lands_within_m=4.0,
        lands_at_ne_m=HOME,
    ),
    Scenario(
        name="lens covered for good, and then the link cut for 2 s",
        setup=setup(wind_m_s=5.0),
        breaks=(
            Break(fault=camera.CameraTrouble(camera.black), at_s=BREAKS_AT_S),
            Break(fault=link.LinkCut(), at_s=BREAKS_AT_S + 2.0, for_s=2.0),
        ),
        limit_s=90.0,
        follows=(phase(10.0, "landing"), down(60.0)),
        lands_within_m=50.0,
    ),
    Scenario(
        name="camera gone for good, and then the navigator killed",
        setup=setup(wind_m_s=5.0),
        breaks=(
            Break(fault=camera.CameraTrouble(camera.no_images), at_s=BREAKS_AT_S),
            Break(fault=computer.NavigatorKilled(), at_s=BREAKS_AT_S + 0.5),
        ),
        limit_s=100.0,
        follows=(down(75.0),),
        lands_within_m=50.0,
    ),
]
TURNED = [
    Scenario(
        name="navigator killed, and then the heading reset by 90 degrees",
        setup=setup(),
        breaks=(
            Break(fault=computer.NavigatorKilled(), at_s=BREAKS_AT_S),
            Break(fault=aircraft.HeadingReset(math.pi / 2), at_s=BREAKS_AT_S + 2.8),
        ),
        limit_s=75.0,
        follows=(down(70.0),),
        lands_within_m=70.0,
    ),
]
# What the first navigator has found out of its camera, the second one goes on with.
_OTHERWISE: tuple[tuple[str, dict[str, Any]], ...] = (
    ("camera turned by 180 degrees", {"mount_off_deg": (0.0, 0.0, 180.0)}),
    ("a lens a fifth narrower than calibrated", {"lens_ratio": 1.25}),
    *NOBODY_KNOWS,
)
FOUND_OUT = [
    Scenario(
        name=f"{what}, and the navigator killed on the route",
        setup=setup(None, **changes),
        breaks=(Break(fault=computer.NavigatorKilled(), at_s=15.0, phase=Phase.ROUTE),),
        limit_s=130.0,
        follows=(said(6.0, "estimates again"), down(70.0)),
        lands_within_m=5.0,
    )
    for what, changes in _OTHERWISE
]
STALE = [
    Scenario(
        name="link cut for 3 s, and the mission raises before it is there again",
        setup=setup(),
        breaks=(
            Break(fault=link.LinkCut(), at_s=BREAKS_AT_S, for_s=3.0),
            Break(fault=computer.StepRaises("mission"), at_s=BREAKS_AT_S + 2.5),
        ),
        limit_s=90.0,
        follows=(unsaid(80.0, "the watchdog does not hand it on"), down(80.0)),
        lands_within_m=30.0,
    ),
]
# It looks for the map from higher up, finds it, goes on, and loses it again.
SNOW = [
    Scenario(
        name=", ".join(filter(None, (how, "no fix for 20 s, fixes for 3 s, and then none"))),
        setup=setup(**changes),
        breaks=(
            Break(fault=fixes.NoFixes(), at_s=BREAKS_AT_S, for_s=20.0),
            Break(fault=fixes.NoFixes(), at_s=BREAKS_AT_S + 23.0),
        ),
        limit_s=200.0,
        follows=(
            said(22.0, "climbing to where the map shows more"),
            said(24.0, "all well again"),
            phase(60.0, "returning"),
            down(180.0),
        ),
        lands_within_m=5.0,
        lands_at_ne_m=HOME,
    )
    for how, changes in (("", {}), *NOBODY_KNOWS)
]
_CUT = Break(fault=link.LinkCut(), at_s=BREAKS_AT_S, for_s=3.0)
# PX4 has fallen back to a mode that stays up by the time that the link is there again.
FALLEN_BACK = [
    *(
        with_action(
            Scenario(
                name="link cut for 3 s, and the navigator killed before it has asked to land",
                setup=setup(),
                breaks=(
                    _CUT,
                    Break(fault=computer.NavigatorKilled(), at_s=BREAKS_AT_S + 3.3),
                ),
                limit_s=110.0,
                follows=(down(90.0),),
                lands_within_m=70.0,
            ),
            *stays_up,
        )
        for stays_up in STAY_UP
    ),
    # To the sticks, which are heard: whoever moves them, PX4 tells that Offboard is intended.
    with_action(
        Scenario(
            name="link cut for 3 s beside a pilot whose radio is on",
            setup=setup(rc_on=True),
            breaks=(_CUT,),
            limit_s=30.0,
            ending=Ending.PILOT,
            follows=(phase(6.0, "pilot flies"),),
        ),
        "px4-1.16",
        0,
    ),
]
# A navigator that is gone starts no watchdog: whoever guards the aircraft then is the last but for
# the spare one behind it.
NOBODY_LEFT = [
    Scenario(
        name=name,
        setup=setup(wind_m_s=5.0),
        breaks=(Break(fault=ends, at_s=BREAKS_AT_S), *guards),
        limit_s=100.0,
        follows=(down(75.0),),
        lands_within_m=70.0,
    )
    for name, ends, guards in (
        (
            "navigator and watchdog killed",
            computer.NavigatorKilled(),
            (Break(fault=computer.WatchdogKilled(), at_s=BREAKS_AT_S),),
        ),
        (
            "navigator killed, and the watchdog while it holds",
            computer.NavigatorKilled(),
            (Break(fault=computer.WatchdogKilled(), at_s=BREAKS_AT_S + 2.5),),
        ),
        (
            "navigator killed, and then the watchdog hangs",
            computer.NavigatorKilled(),
            (Break(fault=computer.WatchdogHangs(), at_s=BREAKS_AT_S + 2.5),),
        ),
        (
            "navigator stopped, and the watchdog killed while it brakes",
            computer.NavigatorStopped(20.0),
            (Break(fault=computer.WatchdogKilled(), at_s=BREAKS_AT_S + 1.0),),
        ),
        (
            "navigator killed, and then the watchdog three times",
            computer.NavigatorKilled(),
            tuple(
                Break(fault=computer.WatchdogKilled(), at_s=BREAKS_AT_S + after_s)
                for after_s in (2.0, 8.0, 14.0)
            ),
        ),
    )
]
TOGETHER = [
    *LOOSE, *STORM, *BOTH_HANDS, *BLIND, *TURNED, *FOUND_OUT, *STALE, *SNOW, *FALLEN_BACK,
    *NOBODY_LEFT,
]  # fmt: skip
