"""The bench: every feature set on the same scenes, side by side. Workstation only."""
