"""A flight in lockstep as the rules see it."""

from collections.abc import Iterable

from vwnav.bench.flights.faults.link import RoundTrip
from vwnav.bench.flights.scenario import Flown
from vwnav.config import Config
from vwnav.mission.mission import Phase
from vwnav.rules.flight_log import (
    At,
    FlightLimits,
    FlightLog,
    LoggedTruth,
    LoggedVehicle,
    Moment,
    PhaseStart,
    Said,
    Vector,
)
from vwnav.rules.temporal import inside
from vwnav.seams import StepResult
from vwnav.types import Array, MapFix, OdometryMotion

_ANSWERED_S = 0.5  # asked five times a second, on a link that has to catch up


def flight_log(flown: Flown) -> FlightLog:
    """Times are those of the world's clock."""
    track, heard, begun_s = flown.track, flown.track.heard, flown.begun_s
    steps = [*flown.steps, *flown.second_steps]
    broken = [(lo + begun_s, hi + begun_s) for lo, hi in flown.broken]
    # Of a time that a simulator did not have, and until a TIMESYNC answer can tell of it.
    stood = [(lo + begun_s, hi + begun_s + _ANSWERED_S) for lo, hi in flown.stood]
    faults = [each.fault for each in flown.scenario.breaks]
    trips = [each.seconds for each in faults if isinstance(each, RoundTrip)]
    return FlightLog(
        bounds=bounds_of(flown.scenario.setup.config),
        vehicle=[
            LoggedVehicle(
                row.t_s,
                row.mode,
                row.armed,
                not row.on_ground,
                row.battery_ratio,
            )
            for row in track.truth
        ],
        estimates=[
            each
            for each in heard.estimates
            if not (inside(each.stamp_s, stood) or inside(each.t_s, stood))
        ],
        setpoints=heard.setpoints,
        commands=heard.commands,
        answers=heard.answers,
        parameters_set=heard.parameters_set,
        beats=heard.beats,
        phases=[PhaseStart(row.t_s + begun_s, Phase(row.text)) for row in track.phases],
        events=[Said(row.t_s + begun_s, row.text) for row in track.events],
        fixes=_fixes(flown, steps),
        sights=[Moment(step.t_s) for step in steps if _tells_something(step)],
        beliefs=[
            At(
                step.t_s,
                (
                    float(step.estimate.velocity_ned_m_s[0]),
                    float(step.estimate.velocity_ned_m_s[1]),
                ),
            )
            for step in steps
            if step.estimate is not None
        ],
        homes=track.homes,
        map_off_m=flown.scenario.map_off_m,
        map_sigma_m=flown.scenario.setup.map_warp.shift_sigma_m,
        truth=[
            LoggedTruth(row.t_s, _vector(row.position_ned_m), _vector(row.velocity_ned_m_s))
            for row in track.truth
        ],
        broken=broken,
        round_trip_s=max(trips, default=0.0),
    )


def bounds_of(config: Config) -> FlightLimits:
    """The settings that a flight is held to."""
    return FlightLimits(
        speed_max_m_s=config.limits.speed_max_m_s,
        climb_m_s=config.limits.climb_m_s,
        descend_m_s=config.limits.descend_m_s,
        safety=config.safety,
        estimate=config.estimate,
        flight=config.flight,
    )


def _tells_something(step: StepResult) -> bool:
    """A motion or a place, as the runtime counts images."""
    return isinstance(step.motion, OdometryMotion) or isinstance(step.outcome, MapFix)


def _fixes(flown: Flown, steps: Iterable[StepResult]) -> list[At]:
    frame = flown.local_frame
    found = []
    for step in steps:
        if isinstance(step.outcome, MapFix):
            ned_m = frame.to_ned(step.outcome.lat_deg, step.outcome.lon_deg, frame.alt_amsl_m)
            found.append(At(step.outcome.t_s, (float(ned_m[0]), float(ned_m[1]))))
    return sorted(found, key=lambda fix: fix.t_s)


def _vector(ned: Array) -> Vector:
    north, east, down = ned.tolist()
    return north, east, down
