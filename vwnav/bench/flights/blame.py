"""What the operator is told to be wrong, held against what is wrong.

Who reads that the mount, the lens or the compass is off will take it apart, and calibrate it: no
part may be named that is as it should be.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from vwnav.bench.flights.faults import aircraft, camera, fixes, link, telemetry
from vwnav.bench.flights.scenario import Scenario
from vwnav.sim.map_warp import MapWarp
from vwnav.sim.relief import Relief

_COMPASS_DEG = 10.0  # off by less than that a compass is as good as they are


@dataclass(frozen=True, slots=True)
class _Blame:
    """A part that the program names.

    Attributes:
        words: by which an event names it.
        is_wrong: whether it is, in a scenario, or whatever looks the same from inside.
    """

    part: str
    words: str
    is_wrong: Callable[[Scenario], bool]


def blamed_wrongly(scenario: Scenario, said: Sequence[str]) -> Iterator[str]:
    """What was said of parts that are as they should be, each part once."""
    for blame in _BLAMES:
        texts = [text for text in said if blame.words in text]
        if texts and not blame.is_wrong(scenario):
            yield f"the {blame.part} is as it should be, and it says {texts[0]!r}"


def _breaks(scenario: Scenario, *kinds: type) -> bool:
    return any(isinstance(each.fault, kinds) for each in scenario.breaks)


def _shows(scenario: Scenario, *troubles: Callable[[], camera.Trouble]) -> bool:
    faults = [each.fault for each in scenario.breaks]
    return any(isinstance(f, camera.CameraTrouble) and f.make in troubles for f in faults)


def _mount(scenario: Scenario) -> bool:
    hangs_off = any(scenario.setup.mount_off_deg) or _breaks(scenario, camera.CameraKnocked)
    return hangs_off or _shows(scenario, camera.upside_down, camera.mirrored)


def _driver(scenario: Scenario) -> bool:
    return _shows(scenario, camera.mirrored)


def _lens(scenario: Scenario) -> bool:
    return scenario.setup.lens_ratio != 1.0 or _shows(
        scenario, camera.another_size, camera.cropped, camera.stabilised, camera.zoomed_in
    )


def _dates(scenario: Scenario) -> bool:
    """Of images; what the autopilot dates late makes them look early."""
    is_off = scenario.setup.late_s != 0.0 or _shows(scenario, camera.false_times)
    return is_off or _breaks(scenario, camera.ImagesLate, telemetry.TelemetryLate, link.RoundTrip)


def _compass(scenario: Scenario) -> bool:
    is_off = abs(scenario.setup.compass_off_deg) >= _COMPASS_DEG
    return is_off or _breaks(scenario, aircraft.HeadingReset, telemetry.Altered)


def _heights(scenario: Scenario) -> bool:
    """It is said of the rangefinder with map and barometer: one of the three."""
    return scenario.setup.relief != Relief() or _breaks(
        scenario,
        aircraft.BarometerWrong,
        aircraft.BarometerDrifts,
        aircraft.AirTemperature,
        aircraft.RangefinderStuck,
        aircraft.RangefinderOff,
        aircraft.RangefinderEnds,
        aircraft.RangefinderWild,
    )


def _map(scenario: Scenario) -> bool:
    is_off = scenario.setup.map_warp != MapWarp() or scenario.map_off_m > 0.0
    return is_off or _breaks(scenario, fixes.MapSteps)


_BLAMES = (
    _Blame("map", "the map steps", _map),
    _Blame("mount", "mount_rpy_deg", _mount),
    _Blame("driver", "mirrors its pictures", _driver),
    _Blame("dating", "than its time_offset_s", _dates),
    _Blame("lens", "as wide as its calibration", _lens),
    _Blame("compass", "calibrate its compass", _compass),
    _Blame("rangefinder", "rangefinder contradicts", _heights),
)
