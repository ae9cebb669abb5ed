"""The whole program in simulated time, one thread, one process: flights with something broken."""
