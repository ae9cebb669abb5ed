"""What the command line of `vwnav fly` says."""

import sys
from dataclasses import dataclass, fields
from pathlib import Path

from vwnav.sim.config import Manners


@dataclass(frozen=True, slots=True, kw_only=True)
class FlyOptions:
    """The command line of `vwnav fly`.

    Attributes:
        rejoined: no option: it was started again while the aircraft flew, which then came down
            nobody knows where.
    """

    sim: bool
    realtime: bool
    arm: bool
    standby: bool
    features: str | None
    map_source: str | None
    route: Path | None
    route_frame: str
    camera: Path | None
    video: str | None
    connection: str | None
    truth: str | None
    home: str | None
    home_sigma_m: float
    manners: Manners
    wind_m_s: float
    seed: int
    model: Path | None
    config_path: Path | None
    output: Path | None
    rejoined: bool = False

    @property
    def arms(self) -> bool:
        """A person arms a real aircraft, and one whose flight broke off; simulated ones do."""
        return not self.rejoined and (self.arm or self.sim or self.truth is not None)

    def successor(self, folder: Path) -> list[str]:
        """Command line of a second navigator for the same flight; see `vwnav.onboard.successor`."""
        flags = {"map_source": "--map", "config_path": "--config"}
        words = [sys.executable, "-m", "vwnav", "fly", "--standby"]
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, bool) or value is None or field.name == "output":
                continue  # flags are about the first navigator's part: arming, simulated time
            words += [flags.get(field.name, "--" + field.name.replace("_", "-")), str(value)]
        return [*words, "--output", str(folder / "successor")]
