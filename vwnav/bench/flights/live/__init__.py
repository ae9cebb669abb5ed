"""Flights of `vwnav fly` in real time, against any autopilot in simulation."""
