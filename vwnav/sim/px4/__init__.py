"""The simulated PX4 of `vwnav.sim.vehicle`: airframe, estimator, control, modes, MAVLink."""
