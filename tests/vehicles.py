"""States of a vehicle that tests start from."""

from vwnav.vehicle import FlightMode, VehicleState

FLYING = VehicleState(
    t_s=0.0,
    connected=True,
    armed=True,
    in_air=True,
    mode=FlightMode.OFFBOARD,
    attitude=None,
    height_m=50.0,
    height_t_s=0.0,
    rangefinder_m=None,
    battery_ratio=0.9,
    rc_available=True,
    local_position_ok=True,
    armable=True,
    silence_s=0.1,
)
