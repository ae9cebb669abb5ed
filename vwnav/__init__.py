"""vwnav: a drone that flies without GPS, by matching its down-looking camera to a map."""

__version__ = "0.1.0"
