"""The autopilot's attitude, inertial sensors and barometer: late, missing, wrong."""

import math

from vwnav.bench.flights.faults import aircraft, telemetry
from vwnav.bench.flights.faults.link import HeldBack
from vwnav.bench.flights.scenario import (
    BREAKS_AT_S,
    Break,
    Ending,
    Scenario,
    again_and_again,
    flies_on,
    flies_route,
    phase,
    setup,
    unsaid,
)

ATTITUDES = (telemetry.ATTITUDE, telemetry.ATTITUDE_QUATERNION)
IMU = (telemetry.HIGHRES_IMU,)
RESET_RAD, OFF_RAD = math.radians(20.0), math.radians(30.0)

MISSING = [
    *(
        flies_on(f"attitude missing for {seconds:g} s", telemetry.Missing(), seconds)
        for seconds in (0.05, 0.2, 1.0, 5.0)
    ),
]
LATE = [
    flies_on("telemetry 0.1 s late", telemetry.TelemetryLate(0.1), 10.0),
    flies_on("telemetry 0.3 s late", telemetry.TelemetryLate(0.3), 10.0),
    flies_on("telemetry held back for 1 s", HeldBack(1.0), 1.1),
    Scenario(
        name="telemetry held back for 1.9 s",
        setup=setup(),
        breaks=(Break(fault=HeldBack(1.9), at_s=BREAKS_AT_S, for_s=2.0),),
        limit_s=90.0,
        lands_within_m=30.0,
    ),
    flies_on("attitude 0.1 s late", telemetry.TelemetryLate(0.1, ATTITUDES), 10.0),
    flies_on("attitude 0.3 s late", telemetry.TelemetryLate(0.3, ATTITUDES), 10.0),
    flies_on("attitude 1 s late", telemetry.TelemetryLate(1.0, ATTITUDES), after_s=20.0),
    Scenario(
        name="telemetry 0.7 s late from the start",
        setup=setup(None),
        breaks=(Break(fault=telemetry.TelemetryLate(0.7), at_s=0.0),),
        limit_s=60.0,
        ending=Ending.STAYED,
    ),
    Scenario(
        name="telemetry 1.5 s late before take-off",
        setup=setup(None),
        breaks=(Break(fault=telemetry.TelemetryLate(1.5), at_s=3.0, for_s=20.0),),
        limit_s=80.0,
        ending=Ending.FLIES_ON,
        follows=(phase(60.0, "on route"), unsaid(77.0, "estimate is not sent")),
    ),
]
WRONG = [
    flies_on("one attitude level and facing north", telemetry.level(), 0.02),
    flies_on("attitudes level and facing north for 1 s", telemetry.level(), 1.0),
    flies_on("one attitude not a number", telemetry.not_a_number(), 0.02),
    flies_on("one heading 30 degrees off", telemetry.turned(OFF_RAD), 0.02),
    flies_on("headings 30 degrees off for 10 s", telemetry.turned(OFF_RAD), 10.0),
    flies_on("heading reset by 20 degrees", aircraft.HeadingReset(RESET_RAD), after_s=15.0),
    *(
        flies_route(f"compass {degrees} degrees off", compass_off_deg=float(degrees))
        for degrees in (60, 180)
    ),
    *(
        flies_route(
            f"heading reset by {degrees} degrees before take-off",
            Break(fault=aircraft.HeadingReset(math.radians(degrees)), at_s=0.0),
        )
        for degrees in (60, 180)
    ),
    flies_on("heading reset by 90 degrees", aircraft.HeadingReset(math.pi / 2), after_s=15.0),
    Scenario(
        name="heading drifts by 40 degrees within 20 s",
        setup=setup(),
        breaks=again_and_again(aircraft.HeadingReset(math.radians(0.4)), 0.2, None, 100),
        limit_s=50.0,
        ending=Ending.FLIES_ON,
    ),
]
INERTIAL = [
    flies_on("IMU missing for 10 s", telemetry.Missing(IMU), 10.0),
    flies_on("IMU doubled for 10 s", telemetry.Doubled(IMU), 10.0),
    flies_on("IMU turns on its side in flight", telemetry.imu_on_its_side(), after_s=15.0),
    flies_on(
        "accelerometer 3 m/s^2 off to the right",
        telemetry.accelerometer_off(0.0, 3.0, 0.0),
        after_s=15.0,
    ),
    flies_on(
        "accelerometer 5 m/s^2 off downwards",
        telemetry.accelerometer_off(0.0, 0.0, 5.0),
        after_s=15.0,
    ),
    flies_on("IMU shaken by a propeller out of balance", telemetry.imu_shaken(5.0, 0.2), 20.0),
    flies_on("IMU shaken too much to be of use", telemetry.imu_shaken(15.0, 0.6), 20.0),
    Scenario(
        name="IMU mounted on its side",
        setup=setup(None),
        breaks=(Break(fault=telemetry.imu_on_its_side(), at_s=0.0),),
        limit_s=80.0,
        ending=Ending.FLIES_ON,
        follows=(phase(75.0, "on route"),),
    ),
]
BAROMETER = [
    flies_on("barometer 6 m off for 0.7 s", aircraft.BarometerWrong(6.0), 0.7),
    flies_on("barometer 3 m off for good", aircraft.BarometerWrong(3.0), after_s=15.0),
    flies_on("barometer drifts by 0.3 m/s for 20 s", aircraft.BarometerDrifts(0.3), 20.0),
    flies_route(
        "barometer drifts by 0.3 m/s in the climb",
        Break(fault=aircraft.BarometerDrifts(0.3), at_s=20.0, for_s=20.0),
    ),
]
AIR = [
    flies_route(
        f"air of {degrees_c:g} degrees",
        Break(fault=aircraft.AirTemperature(degrees_c), at_s=0.0),
        range_most_m=most_m,
    )
    for degrees_c in (-20.0, 40.0)
    for most_m in (100.0, 12.0, 0.0)
]
RANGEFINDER = [
    flies_on("rangefinder stuck at 3 m for good", aircraft.RangefinderStuck(3.0), after_s=30.0),
    flies_on("rangefinder stuck at 44 m for good", aircraft.RangefinderStuck(44.0), after_s=30.0),
    flies_on("rangefinder 20 % short for good", aircraft.RangefinderOff(0.8), after_s=30.0),
    flies_on("rangefinder 10 % long for 10 s", aircraft.RangefinderOff(1.1), 10.0, after_s=15.0),
    *(
        flies_route(f"rangefinder {name} from the start", Break(fault=fault, at_s=0.0))
        for name, fault in (
            ("20 % short", aircraft.RangefinderOff(0.8)),
            ("10 % long", aircraft.RangefinderOff(1.1)),
            ("stuck at 0.2 m", aircraft.RangefinderStuck(0.2)),
            ("saying 12 m of all that is farther", aircraft.RangefinderEnds(12.0)),
            ("a third of it wild", aircraft.RangefinderWild(0.33)),
        )
    ),
]
TELEMETRY = [*MISSING, *LATE, *WRONG, *INERTIAL, *BAROMETER, *AIR, *RANGEFINDER]
