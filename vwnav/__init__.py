"""vwnav: a drone that flies without GPS, by matching its down-looking camera to a map."""

import os

__version__ = "0.1.0"

# onnxruntime's wheels report to their maker: a number of this device and what is run on it, kept in
# a database that is written in flight, and sent. Read once, when it loads.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
