"""The thesis' three flight tests (5.4): hover, waypoints, failsafe."""
