"""A recording as the rules see it: what `Recorder` keeps, five times a second."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

from vwnav.errors import SourceError
from vwnav.files.tables import named_rows
from vwnav.geometry.geodesy import LocalFrame
from vwnav.mission.config import FlightConfig
from vwnav.mission.mission import Phase
from vwnav.recording.input_log import INPUT_TOPIC
from vwnav.recording.reader import VEHICLE_TOPIC, Record, read_metadata, read_recording
from vwnav.rules.flight_log import (
    At,
    FlightLimits,
    FlightLog,
    LoggedSetpoint,
    LoggedTruth,
    LoggedVehicle,
    Moment,
    PhaseStart,
    Said,
    Sent,
    Vector,
)
from vwnav.safety.safety_config import EstimateLimits, SafetyConfig
from vwnav.vehicle import FlightMode

_NOT_RECORDED = frozenset({"commands", "answers", "parameters_set", "beats", "beliefs", "homes"})
_TOPICS = frozenset({VEHICLE_TOPIC, "/estimate", "/setpoint", "/event", "/fix", INPUT_TOPIC})
_PHASES = {phase.value: phase for phase in Phase}
_TRUTH_COLUMNS = ("t_s", "north_m", "east_m", "alt_amsl_m")

SettingsT = TypeVar("SettingsT", SafetyConfig, EstimateLimits, FlightConfig)


def recorded_flight_log(path: Path, truth: Path | None = None) -> FlightLog:
    """The log of a recorded flight; times are the recording's own.

    Args:
        path: an MCAP file of `Recorder`.
        truth: CSV with t_s, north_m, east_m, alt_amsl_m on the recording's clock and origin.

    Raises:
        SourceError: one of them cannot be read, or the recording is of no flight.
    """
    found = read_metadata(path)
    records = list(read_recording(path, _TOPICS))
    by_topic = {topic: [r for r in records if r.topic == topic] for topic in _TOPICS}
    if not by_topic[VEHICLE_TOPIC]:
        raise SourceError(f"{path} holds no telemetry of a flight: there is nothing to check")
    try:
        return FlightLog(
            bounds=_bounds(found.get("config") or {}),
            vehicle=[_vehicle(record.content) for record in by_topic[VEHICLE_TOPIC]],
            estimates=[_sent(record) for record in by_topic["/estimate"]],
            setpoints=[_setpoint(record) for record in by_topic["/setpoint"]],
            phases=_phases(by_topic["/event"], by_topic[VEHICLE_TOPIC][0].t_s),
            events=[Said(record.t_s, record.content["text"]) for record in by_topic["/event"]],
            fixes=_fixes(by_topic["/fix"], (found.get("run") or {}).get("origin")),
            sights=_sights(by_topic[INPUT_TOPIC]),
            truth=[] if truth is None else _truth(truth),
            unknown=_NOT_RECORDED | _missing(found, by_topic, truth),
            sampled=True,
        )
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        raise SourceError(f"{path} is not a recording of a flight: {error!r}") from error


def _missing(
    found: Mapping[str, Any], by_topic: Mapping[str, list[Record]], truth: Path | None
) -> set[str]:
    """Streams that this recording lacks.

    Without an origin a fix is nowhere in NED, and in one that begins in the air nobody said the
    first phase.
    """
    there = {
        "fixes": "origin" in (found.get("run") or {}),
        "sights": bool(by_topic[INPUT_TOPIC]),
        "phases": not by_topic[VEHICLE_TOPIC][0].content["in_air"],
        "truth": truth is not None,
    }
    return {name for name, is_there in there.items() if not is_there}


def _vehicle(values: Mapping[str, Any]) -> LoggedVehicle:
    return LoggedVehicle(
        values["t_s"],
        FlightMode[values["mode"].upper()],
        values["armed"],
        values["in_air"],
        values["battery_ratio"],
    )


def _sent(record: Record) -> Sent:
    values = record.content
    rows = values["covariance"]
    covariance = tuple(_number(v) for v in (rows[0][0], rows[0][1], rows[1][1]))
    return Sent(
        record.t_s,
        record.t_s,
        _vector(values["position_ned_m"]),
        (covariance[0], covariance[1], covariance[2]),
        values["reset_counter"],
        _vector(values["velocity_ned_m_s"]),
    )


def _setpoint(record: Record) -> LoggedSetpoint:
    names = ("north_m_s", "east_m_s", "down_m_s")
    return LoggedSetpoint(record.t_s, _vector([record.content[name] for name in names]))


def _phases(events: Iterable[Record], begun_s: float) -> list[PhaseStart]:
    """Each is said when it is entered; getting ready goes before the first."""
    told = [(record.t_s, _PHASES.get(record.content["text"])) for record in events]
    entered = [PhaseStart(t_s, phase) for t_s, phase in told if phase is not None]
    return [PhaseStart(begun_s, Phase.GET_READY), *entered]


def _fixes(records: Iterable[Record], origin: Mapping[str, float] | None) -> list[At]:
    """Of recordings that say what their origin is."""
    if origin is None:
        return []
    frame = LocalFrame(**origin)
    found = []
    for values in (record.content for record in records if record.content["kind"] == "fix"):
        ned_m = frame.to_ned(values["lat_deg"], values["lon_deg"], frame.alt_amsl_m)
        found.append(At(values["t_s"], (float(ned_m[0]), float(ned_m[1]))))
    return sorted(found, key=lambda fix: fix.t_s)


def _sights(records: Iterable[Record]) -> list[Moment]:
    times = (r.content["t1_s"] for r in records if r.content.get("kind") == "odometry")
    return [Moment(t_s) for t_s in sorted(times)]


def _bounds(config: Mapping[str, Any]) -> FlightLimits:
    """The recorded settings; those that this version does not know do not count."""
    limits = config.get("limits") or {}
    default = FlightLimits()
    return FlightLimits(
        speed_max_m_s=limits.get("speed_max_m_s", default.speed_max_m_s),
        climb_m_s=limits.get("climb_m_s", default.climb_m_s),
        descend_m_s=limits.get("descend_m_s", default.descend_m_s),
        safety=_settings(SafetyConfig, config.get("safety")),
        estimate=_settings(EstimateLimits, config.get("estimate")),
        flight=_settings(FlightConfig, config.get("flight")),
    )


def _settings(kind: type[SettingsT], values: Mapping[str, Any] | None) -> SettingsT:
    known = {field.name for field in fields(kind)}
    return kind(**{name: value for name, value in (values or {}).items() if name in known})


def _truth(path: Path) -> list[LoggedTruth]:
    """Velocities are differences; down is from where it stood at first.

    Raises:
        SourceError: the file cannot be read, or holds no numbers under these columns.
    """
    wanted = ", ".join(_TRUTH_COLUMNS)
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            _, named = named_rows(file, path, SourceError)
            rows = [[float(row[name]) for name in _TRUTH_COLUMNS] for _, row in named]
    except OSError as error:
        raise SourceError(f"cannot read {path}: {error.strerror}") from error
    except (LookupError, TypeError, ValueError) as error:
        raise SourceError(f"{path} is no truth: expected the columns {wanted}") from error
    if not rows:
        raise SourceError(f"{path} is no truth: expected rows under the columns {wanted}")
    found: list[LoggedTruth] = []
    for (t_s, north, east, up), after in zip(rows, [*rows[1:], rows[-1]], strict=True):
        span_s = after[0] - t_s
        velocity = (
            ((after[1] - north) / span_s, (after[2] - east) / span_s, (up - after[3]) / span_s)
            if span_s > 0.0
            else (0.0, 0.0, 0.0)
        )
        found.append(LoggedTruth(t_s, (north, east, rows[0][3] - up), velocity))
    return found


def _vector(values: Iterable[float | None]) -> Vector:
    north, east, down = (_number(value) for value in values)
    return north, east, down


def _number(value: float | None) -> float:
    """NaN is recorded as null."""
    return math.nan if value is None else float(value)
