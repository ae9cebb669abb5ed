"""What a fault is: something that changes the world for a while, and puts it back."""

from typing import Protocol

from vwnav.bench.flights.world import World


class Fault(Protocol):
    """One thing that breaks."""

    def begin(self, world: World) -> None:
        """It breaks."""
        ...

    def end(self, world: World) -> None:
        """It works again."""
        ...
