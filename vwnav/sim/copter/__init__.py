"""The simulated vehicle in ArduCopter's manners, as recorded from ArduCopter 4.7."""
