"""One flight of the simulated vehicle by MAVSDK 4, as the navigator flies it."""

import asyncio
import math
from dataclasses import dataclass, field
from typing import Any

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.mocap import MocapAsync
from mavsdk.asyncio.plugins.offboard import OffboardAsync
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.plugins.mocap import AngleBody, Covariance, PositionBody, VisionPositionEstimate
from mavsdk.plugins.offboard import VelocityNedYaw
from mavsdk.plugins.telemetry import FlightMode
from px4_client import make_config

from vwnav.geometry.geodesy import LocalFrame
from vwnav.sim.truth import TruthReader
from vwnav.sim.vehicle import VehicleConfig, start_vehicle


@dataclass
class Report:
    """What MAVSDK saw."""

    vision_parameter: int = -1
    parameters: int = 0
    early_arm: str = ""
    armable: bool = False
    local_position_ok: bool = False
    origin_deg: float = 0.0
    height_m: float = 0.0
    modes: list[str] = field(default_factory=list)
    speed_m_s: float = 0.0
    battery_percent: float = 0.0
    landed: bool = False


async def _see(mocap: MocapAsync, truth: TruthReader, frame: LocalFrame) -> None:
    covariance = [0.0] * 21
    covariance[0] = covariance[6] = covariance[11] = 0.25
    while True:
        state = truth.latest()
        if state is not None:
            ned = frame.to_ned(state.lat_deg, state.lon_deg, state.alt_amsl_m)
            n, e, d = (float(v) for v in ned)
            nothing = AngleBody(math.nan, math.nan, math.nan)
            await mocap.set_vision_position_estimate(
                VisionPositionEstimate(0, PositionBody(n, e, d), nothing, Covariance(covariance), 0)
            )
        await asyncio.sleep(0.02)


async def _until(good: Any, timeout_s: float) -> bool:
    for _ in range(round(timeout_s / 0.05)):
        if await good():
            return True
        await asyncio.sleep(0.05)
    return False


async def _fly(config: VehicleConfig, truth: TruthReader, report: Report) -> None:
    mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.COMPANION_COMPUTER))
    port = config.companion_url.rsplit(":", 1)[1]
    await mavsdk.add_any_connection(f"udpin://127.0.0.1:{port}")
    system = await mavsdk.first_autopilot(20)
    action, telemetry, parameters = ActionAsync(system), TelemetryAsync(system), ParamAsync(system)
    report.vision_parameter = await parameters.get_param_int("EKF2_EV_CTRL")
    everything = await parameters.get_all_params()
    report.parameters = len(everything.int_params) + len(everything.float_params)
    try:
        await action.arm()
    except Exception as error:
        report.early_arm = str(error)
    place = (config.home_lat_deg, config.home_lon_deg, config.home_alt_amsl_m)
    await action.set_gps_global_origin(*place)
    report.origin_deg = (await telemetry.get_gps_global_origin()).latitude_deg
    seeing = asyncio.create_task(_see(MocapAsync(system), truth, LocalFrame(*place)))
    await asyncio.sleep(14.0 / config.speed)

    async def armable() -> bool:
        health = await telemetry.health()
        report.local_position_ok = health.is_local_position_ok
        return bool(health.is_armable)

    report.armable = await _until(armable, 10.0)
    await _leg(action, telemetry, OffboardAsync(system), truth, report)
    seeing.cancel()


async def _leg(
    action: ActionAsync,
    telemetry: TelemetryAsync,
    offboard: OffboardAsync,
    truth: TruthReader,
    report: Report,
) -> None:
    async def mode_is(name: str) -> bool:
        mode = FlightMode(await telemetry.flight_mode()).name
        if not report.modes or report.modes[-1] != mode:
            report.modes.append(mode)
        return name == mode

    await action.set_takeoff_altitude(8.0)
    await action.arm()
    await action.takeoff()
    await _until(lambda: mode_is("TAKEOFF"), 10.0)
    await _until(lambda: mode_is("HOLD"), 30.0)
    report.height_m = (await telemetry.position()).relative_altitude_m
    await offboard.set_velocity_ned(VelocityNedYaw(3.0, 0.0, 0.0, 90.0))
    await offboard.start()
    await _until(lambda: mode_is("OFFBOARD"), 10.0)
    await asyncio.sleep(3.0)
    state = truth.latest()
    report.speed_m_s = 0.0 if state is None else state.velocity_ned_m_s[0]
    report.battery_percent = (await telemetry.battery()).remaining_percent
    await action.land()
    await _until(lambda: mode_is("LAND"), 10.0)

    async def disarmed() -> bool:
        return not await telemetry.armed()

    report.landed = await _until(disarmed, 40.0)


def fly() -> Report:
    """Fly at twice real time; what went wrong shows in the report."""
    config, report = make_config(speed=2.0, wind_m_s=3.0), Report()
    with start_vehicle(config):
        truth = TruthReader(config.truth_url.replace("udpin", "udpout"))
        try:
            asyncio.run(asyncio.wait_for(_fly(config, truth, report), 75.0))
        finally:
            truth.close()
    return report
