"""Shares the small generated place with every smoke test."""

from smoke_place import place, vwnav

__all__ = ["place", "vwnav"]
