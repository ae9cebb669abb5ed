"""What every simulated autopilot needs to speak MAVLink, whatever it says."""
