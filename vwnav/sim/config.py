"""Everything that can be chosen about the simulated vehicle, in one frozen dataclass."""

import math
from dataclasses import dataclass, field
from typing import Literal, get_args

from vwnav.errors import ConfigError
from vwnav.sim.relief import Relief

Manners = Literal["px4", "px4-1.16", "copter"]


@dataclass(frozen=True, slots=True, kw_only=True)
class PilotPlan:
    """What the pilot at the radio does, in seconds of simulated time since start; None is never.

    Attributes:
        rc_on: a radio is bound and its transmitter is on.
        takes_over_at_s: pushes the pitch stick forward in 0.4 s, lets go 3 s later.
        switch_at_s: flips the mode switch (channel 5) to Position, Loiter on ArduCopter.
        rc_lost_at_s, rc_back_at_s: the transmitter goes off and on.
    """

    rc_on: bool = False
    takes_over_at_s: float | None = None
    switch_at_s: float | None = None
    rc_lost_at_s: float | None = None
    rc_back_at_s: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleConfig:
    """The simulated vehicle. Times are simulated seconds since its start.

    Attributes:
        manners: of PX4 1.18, of PX4 of the 1.16 era, or of ArduCopter 4.7.
        home_lat_deg, home_lon_deg, home_alt_amsl_m: where it stands; the ground is level there.
        heading_deg: true heading on the ground, 0 = north, clockwise.
        companion_url, ground_url, truth_url: MAVLink links, "udpout:HOST:PORT" speaks first to
            that port, "udpin:HOST:PORT" answers whoever speaks; "" leaves the link out.
        truth_rate_hz: default rate of HIL_STATE_QUATERNION or SIM_STATE on the truth link.
        speed: simulated seconds per real second.
        clock_file: of a simulated time that others share (`vwnav.pace`); "" for the wall's.
        wind_m_s, wind_from_deg: mean wind at 10 m and above, and where it comes from.
        gust_m_s: one sigma of the turbulence; None is a tenth of the mean wind.
        baro_drift_m: one sigma of the barometer's random walk after ten minutes.
        heading_bias_deg: constant error of the compass.
        imu_noise: scale of the noise and biases of the inertial sensors; 0 is perfect.
        range_most_m: how far its rangefinder reaches; 0: it has none.
        battery_start: charge at start, 0..1.
        battery_drain_s: time in flight from full to empty.
        autopilot_defaults: start with the autopilot's own parameters: GPS expected (there is
            none), vision off.
        parameters: (name, value) pairs laid over the defaults.
        pilot: what the pilot does.
        relief: of the ground; the vehicle stands at its height zero.
    """

    manners: Manners = "px4"
    home_lat_deg: float = 41.1
    home_lon_deg: float = 29.0
    home_alt_amsl_m: float = 40.0
    heading_deg: float = 0.0
    companion_url: str = "udpout:127.0.0.1:14540"
    ground_url: str = "udpout:127.0.0.1:14550"
    truth_url: str = "udpin:127.0.0.1:14560"
    truth_rate_hz: float = 100.0
    system_id: int = 1
    speed: float = 1.0
    clock_file: str = ""
    seed: int = 1
    wind_m_s: float = 0.0
    wind_from_deg: float = 270.0
    gust_m_s: float | None = None
    baro_drift_m: float = 1.5
    heading_bias_deg: float = 3.0
    imu_noise: float = 1.0
    range_most_m: float = 100.0
    battery_start: float = 1.0
    battery_drain_s: float = 1500.0
    autopilot_defaults: bool = False
    parameters: tuple[tuple[str, float], ...] = ()
    pilot: PilotPlan = field(default_factory=PilotPlan)
    relief: Relief = field(default_factory=Relief)

    def __post_init__(self) -> None:
        """Raise ConfigError on a value that cannot fly."""
        checks = {
            "manners": self.manners in get_args(Manners),
            "home_lat_deg": abs(self.home_lat_deg) < 89.0,
            "home_lon_deg": abs(self.home_lon_deg) <= 180.0,
            "home_alt_amsl_m": abs(self.home_alt_amsl_m) < 9000.0,
            "heading_deg": math.isfinite(self.heading_deg),
            "truth_rate_hz": 1.0 <= self.truth_rate_hz <= 250.0,
            "system_id": 1 <= self.system_id <= 255,
            "speed": 0.1 <= self.speed <= 20.0,
            "wind_m_s": 0.0 <= self.wind_m_s <= 30.0,
            "battery_start": 0.0 < self.battery_start <= 1.0,
            "battery_drain_s": self.battery_drain_s > 0.0,
        }
        for name, good in checks.items():
            if not good:
                raise ConfigError(f"simulated vehicle: {name}={getattr(self, name)} makes no sense")

    @property
    def gust_sigma_m_s(self) -> float:
        """One sigma of the turbulence, as asked or a tenth of the mean wind."""
        return 0.1 * self.wind_m_s if self.gust_m_s is None else self.gust_m_s
