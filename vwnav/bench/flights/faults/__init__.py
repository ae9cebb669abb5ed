"""What can break in a flight, by where it breaks."""
