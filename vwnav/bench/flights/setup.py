"""What a flight in lockstep begins with."""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from vwnav.config import Config
from vwnav.geometry.camera import Camera
from vwnav.geometry.rotations import rotation_from_euler
from vwnav.mission.home import WayHome
from vwnav.mission.mission import Mission, Phase
from vwnav.sim.config import Manners
from vwnav.sim.map_warp import MapWarp
from vwnav.sim.relief import Relief
from vwnav.types import Array
from vwnav.vehicle import FlightMode

# As a pilot sets an aircraft up that flies on vision: see `preflight_parameters`.
PARAMETERS: dict[Manners, tuple[tuple[str, float], ...]] = {
    "px4": (("COM_OBL_RC_ACT", 4), ("COM_LOW_BAT_ACT", 3)),
    "px4-1.16": (("COM_OBL_RC_ACT", 4), ("COM_LOW_BAT_ACT", 3), ("COM_RC_OVERRIDE", 3)),
    "copter": (
        ("BATT_FS_LOW_ACT", 2),
        ("BATT_LOW_VOLT", 10.8),
        ("BATT_LOW_TIMER", 3),
        ("BATT_FS_CRT_ACT", 1),
        ("BATT_CRT_VOLT", 10.2),
        ("FS_GCS_ENABLE", 1),
    ),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class AirStart:
    """A flight that begins in the air, in Offboard or GUIDED: NED about home.

    Attributes:
        phase: where the mission stands; None: the program is started while somebody else flies.
        mode: what the vehicle flies then.
    """

    phase: Phase | None
    place_ned_m: tuple[float, float, float]
    velocity_ned_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    mode: FlightMode = FlightMode.OFFBOARD


@dataclass(frozen=True, slots=True, kw_only=True)
class Setup:
    """Everything about a flight but what breaks in it.

    Attributes:
        manners: whose ways the vehicle has.
        start: None begins on the ground.
        route_ned_m: waypoints about home.
        stands_ne_m: where it stands, about the site's home.
        home_known: False: the program is not told where it stands.
        home_off_ne_m: how far from there it is told to stand.
        rc_on: a pilot holds a radio.
        gust_m_s: one sigma of the turbulence; None is a tenth of the wind.
        vehicle_rate: seconds of the vehicle's clock per second.
        vehicle_fit_s: so long by that rate, then so long by ours, in turns; 0: by that rate always.
        battery_drain_s: time in flight from full to empty.
        arm_m: where the camera sits in the body: forward, right, down.
        mount_yaw_deg: how the camera hangs as calibrated: its upper edge from the nose, clockwise.
        mount_off_deg: how the camera truly hangs, roll, pitch and yaw beyond its calibration.
        lens_ratio: its true focal length over the calibrated one.
        readout_s: what its rows truly take; None: what the simulated camera's take.
        late_s: by how much its images are dated later than exposed, which nobody knows.
        relief: of the ground about home, where it has to stand.
        map_warp: of the map that is flown on.
        range_most_m: how far the rangefinder reaches; 0: there is none.
        compass_off_deg: constant error of the compass.
        copies_map: fly on a copy of the map's file, for faults that damage it.
    """

    manners: Manners = "px4"
    seed: int = 1
    start: AirStart | None = None
    route_ned_m: tuple[tuple[float, float, float], ...] = (
        (60.0, -60.0, -50.0),
        (130.0, 0.0, -50.0),
        (50.0, 70.0, -50.0),
    )
    stands_ne_m: tuple[float, float] = (0.0, 0.0)
    home_known: bool = True
    home_off_ne_m: tuple[float, float] = (0.0, 0.0)
    wind_m_s: float = 4.0
    wind_from_deg: float = 250.0
    gust_m_s: float | None = None
    rc_on: bool = False
    vehicle_rate: float = 1.0
    vehicle_fit_s: float = 0.0
    battery_drain_s: float = 1500.0
    image_hz: float = 10.0
    arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    mount_yaw_deg: float = 0.0
    mount_off_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    lens_ratio: float = 1.0
    readout_s: float | None = None
    late_s: float = 0.0
    relief: Relief = field(default_factory=Relief)
    map_warp: MapWarp = field(default_factory=MapWarp)
    range_most_m: float = 100.0
    compass_off_deg: float = 3.0
    copies_map: bool = False
    parameters: tuple[tuple[str, float], ...] = ()
    config: Config = field(default_factory=Config)

    @property
    def mission(self) -> Mission:
        """What the flight is asked to do."""
        return Mission(
            np.array(self.route_ned_m),
            about_home=not self.home_known,
            home_ne_m=self.told_home_ne_m,
            way_home=WayHome.within(self.config.safety),
        )

    @property
    def told_home_ne_m(self) -> Array | None:
        """(2,) where the program is told that it stands."""
        return np.add(self.stands_ne_m, self.home_off_ne_m) if self.home_known else None

    def vehicle_s(self, t_s: float) -> float:
        """The time on the vehicle's clock at a time on ours."""
        if not self.vehicle_fit_s:
            return self.vehicle_rate * t_s
        turns, rest_s = divmod(t_s, 2.0 * self.vehicle_fit_s)
        slow_s = turns * self.vehicle_fit_s + min(rest_s, self.vehicle_fit_s)
        return t_s - (1.0 - self.vehicle_rate) * slow_s

    def told_camera(self, camera: Camera) -> Camera:
        """A camera, hung as the calibration of this flight says."""
        turn = rotation_from_euler(0.0, 0.0, math.radians(self.mount_yaw_deg))
        return replace(
            camera,
            R_body_camera=turn @ camera.R_body_camera,
            t_body_camera_m=np.array(self.arm_m),
        )

    def true_camera(self, told: Camera) -> Camera:
        """The camera that flies, by what its calibration says of it."""
        off = rotation_from_euler(*map(math.radians, self.mount_off_deg))
        K = told.K.copy()
        K[0, 0], K[1, 1] = self.lens_ratio * K[0, 0], self.lens_ratio * K[1, 1]
        readout_s = told.readout_s if self.readout_s is None else self.readout_s
        return replace(told, K=K, R_body_camera=off @ told.R_body_camera, readout_s=readout_s)
