"""A multirotor and what every autopilot flies it by: airframe, air, sensors, filters, loops."""
