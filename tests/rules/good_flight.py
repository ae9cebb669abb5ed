"""A short flight in which all is well, as a log; tests break one thing in it."""

from dataclasses import replace

from vwnav.mission.mission import Phase
from vwnav.rules.flight_log import (
    At,
    CommandAck,
    FlightLog,
    Heartbeat,
    LoggedCommand,
    LoggedSetpoint,
    LoggedTruth,
    LoggedVehicle,
    Moment,
    ParameterSet,
    PhaseStart,
    Said,
    Sent,
)
from vwnav.vehicle import FlightMode

NAVIGATOR, WATCHDOG = 191, 192
ARM, TAKEOFF, SET_MODE, LAND = 400, 22, 176, 21
OFFBOARD_S, ROUTE_S, LAND_S, DOWN_S, DISARMED_S, END_S = 6.0, 10.0, 24.0, 30.0, 33.0, 36.0
_SPEED_M_S = 4.0
_MODES = (
    (0.0, FlightMode.HOLD),
    (3.0, FlightMode.TAKEOFF),
    (OFFBOARD_S, FlightMode.OFFBOARD),
    (LAND_S + 0.2, FlightMode.LAND),
)


def times(from_s: float, to_s: float, hz: float) -> list[float]:
    return [from_s + k / hz for k in range(round((to_s - from_s) * hz))]


def mode_at(t_s: float) -> FlightMode:
    return next(mode for since_s, mode in reversed(_MODES) if t_s >= since_s)


def north_m(t_s: float) -> float:
    return _SPEED_M_S * (min(max(t_s, ROUTE_S), LAND_S) - ROUTE_S)


def vehicle_at(t_s: float) -> LoggedVehicle:
    in_air = 4.0 <= t_s < DOWN_S
    return LoggedVehicle(t_s, mode_at(t_s), 2.5 <= t_s < DISARMED_S, in_air, 0.9)


def sent_at(t_s: float) -> Sent:
    place = (north_m(t_s - 0.05) + 0.2, 0.0, -10.0)
    return Sent(t_s, t_s - 0.05, place, (0.25, 0.0, 0.25), 0, (_SPEED_M_S, 0.0, 0.0))


def truth_at(t_s: float) -> LoggedTruth:
    moves = ROUTE_S <= t_s < LAND_S
    return LoggedTruth(t_s, (north_m(t_s), 0.0, -10.0), (_SPEED_M_S if moves else 0.0, 0.0, 0.5))


def good_flight() -> FlightLog:
    steering = times(OFFBOARD_S - 0.5, LAND_S, 20.0)
    return FlightLog(
        vehicle=[vehicle_at(t_s) for t_s in times(0.0, END_S, 20.0)],
        estimates=[sent_at(t_s) for t_s in times(0.0, END_S, 20.0)],
        setpoints=[
            LoggedSetpoint(t_s, (_SPEED_M_S if t_s >= ROUTE_S else 0.0, 0.0, 0.0), NAVIGATOR)
            for t_s in steering
        ],
        commands=[
            LoggedCommand(2.4, ARM, (1.0, 0.0, 0.0), NAVIGATOR),
            LoggedCommand(2.6, TAKEOFF, (0.0, 0.0, 0.0), NAVIGATOR),
            LoggedCommand(OFFBOARD_S - 0.2, SET_MODE, (1.0, 6.0, 0.0), NAVIGATOR),
            LoggedCommand(LAND_S, SET_MODE, (1.0, 4.0, 6.0), NAVIGATOR),
        ],
        answers=[
            CommandAck(t_s, number, True)
            for t_s, number in ((2.5, ARM), (2.7, TAKEOFF), (5.9, SET_MODE), (24.1, SET_MODE))
        ],
        parameters_set=[
            ParameterSet(0.5, "EKF2_EV_CTRL", 1.0),
            ParameterSet(7.0, "MIS_TAKEOFF_ALT", 2.5),
        ],
        beats=[Heartbeat(t_s, NAVIGATOR, 18) for t_s in times(0.0, END_S, 1.0)],
        phases=[
            PhaseStart(0.0, Phase.GET_READY),
            PhaseStart(2.8, Phase.TAKEOFF),
            PhaseStart(OFFBOARD_S, Phase.CLIMB),
            PhaseStart(8.0, Phase.FIRST_FIX),
            PhaseStart(ROUTE_S, Phase.ROUTE),
            PhaseStart(22.0, Phase.DESCEND),
            PhaseStart(LAND_S, Phase.LAND),
            PhaseStart(DISARMED_S + 0.1, Phase.DONE),
        ],
        events=[Said(ROUTE_S, "on route")],
        fixes=[At(t_s, (north_m(t_s), 0.3)) for t_s in times(7.0, LAND_S, 2.0)],
        sights=[Moment(t_s) for t_s in times(5.0, LAND_S, 10.0)],
        beliefs=[At(t_s, (_SPEED_M_S, 0.0)) for t_s in times(5.0, LAND_S, 10.0)],
        homes=[At(t_s, (0.0, 0.0)) for t_s in (ROUTE_S, 20.0)],
        truth=[truth_at(t_s) for t_s in times(0.0, END_S, 20.0)],
    )


def with_mode(log: FlightLog, mode: FlightMode, from_s: float, to_s: float = END_S) -> FlightLog:
    rows = [replace(r, mode=mode) if from_s <= r.t_s < to_s else r for r in log.vehicle]
    return replace(log, vehicle=rows)


def with_phases(log: FlightLog, *stages: tuple[float, Phase]) -> FlightLog:
    return replace(log, phases=[PhaseStart(*stage) for stage in stages])


def with_command(log: FlightLog, t_s: float, number: int, *parameters: float) -> FlightLog:
    more = LoggedCommand(t_s, number, (*parameters, 0.0, 0.0, 0.0)[:3], NAVIGATOR)
    return replace(log, commands=sorted([*log.commands, more], key=lambda row: row.t_s))


def with_setpoint(log: FlightLog, t_s: float, *velocity: float, by: int = NAVIGATOR) -> FlightLog:
    north, east, down = velocity
    more = LoggedSetpoint(t_s, (north, east, down), by)
    return replace(log, setpoints=sorted([*log.setpoints, more], key=lambda row: row.t_s))


def with_sent(log: FlightLog, from_s: float, to_s: float = END_S, **changes: object) -> FlightLog:
    rows = [
        replace(r, **changes) if from_s <= r.t_s < to_s else r  # type: ignore[arg-type]
        for r in log.estimates
    ]
    return replace(log, estimates=rows)


def silent(log: FlightLog, stream: str, from_s: float, to_s: float = END_S) -> FlightLog:
    rows = [row for row in getattr(log, stream) if not from_s < row.t_s < to_s]
    return replace(log, **{stream: rows})
