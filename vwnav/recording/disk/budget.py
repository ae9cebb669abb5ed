"""How much of the disk recordings may take: the oldest flights leave first."""

import os
import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from vwnav.errors import VwnavError
from vwnav.settings.ranges import Settings, Within

_OWN_NAME = re.compile(r"fly-\d{8}-\d{6}(-\d+)?")  # what `make_run_folder` calls flights
_LOOK_EVERY_S = 10.0
GB = 1e9


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingConfig(Settings):
    """What recordings may take.

    Attributes:
        most_gb: all flights in the folder `runs` together; the oldest are removed. Folders that
            were named with `-o` are nobody's to remove.
        keep_free_gb: of the disk. Where removing does not help, recording stops; the flight goes
            on.
    """

    most_gb: Annotated[float, Within(0.0, 1e6, above=True)] = 16.0
    keep_free_gb: Annotated[float, Within(0.0, 1e6)] = 1.0


class DiskBudget:
    """Keeps the flights beside the present one inside their budget.

    Args:
        present: folder of the present flight, which is never removed.
        config: the bounds.
        removes: whether older flights beside it may be removed.
        free_bytes: of the disk that a folder is on.
    """

    def __init__(
        self,
        present: Path,
        config: RecordingConfig,
        removes: bool,
        free_bytes: Callable[[Path], int] = lambda folder: shutil.disk_usage(folder).free,
    ) -> None:
        self._present = present
        self._config = config
        self._removes = removes
        self._free_bytes = free_bytes
        self._look_s = 0.0

    def keep(self, t_s: float) -> None:
        """Look every ten seconds whether there is room, and make some.

        Raises:
            VwnavError: there is none, and nothing to remove.
        """
        if t_s < self._look_s:
            return
        self._look_s = t_s + _LOOK_EVERY_S
        self.make_room()
        free_gb = self._free_bytes(self._present) / GB
        if free_gb < self._config.keep_free_gb:
            raise VwnavError(f"only {free_gb:.1f} GB of the disk are free; remove something")
        if self._removes and self._taken_bytes() > self._config.most_gb * GB:
            raise VwnavError(f"flights take more than {self._config.most_gb:g} GB")

    def make_room(self) -> list[str]:
        """Remove the oldest flights until the rest keep the bounds; returns their names."""
        removed = []
        for folder in self._older_flights():
            if self._is_room():
                break
            shutil.rmtree(folder, ignore_errors=True)
            removed.append(folder.name)
        return removed

    def _is_room(self) -> bool:
        enough_free = self._free_bytes(self._present) >= self._config.keep_free_gb * GB
        return enough_free and self._taken_bytes() <= self._config.most_gb * GB

    def _older_flights(self) -> list[Path]:
        """Flights beside the present one, the oldest first."""
        if not self._removes:
            return []
        return sorted(each for each in self._flights() if each.name != self._present.name)

    def _flights(self) -> list[Path]:
        return flights_in(self._present.parent)

    def _taken_bytes(self) -> int:
        return sum(
            _bytes_of(Path(folder) / name)
            for flight in self._flights()
            for folder, _, names in os.walk(flight)
            for name in names
        )


def flights_in(runs: Path) -> list[Path]:
    """Folders of flights that were not named by a person."""
    return [
        each
        for each in runs.iterdir()
        if _OWN_NAME.fullmatch(each.name) and each.is_dir() and not each.is_symlink()
    ]


def _bytes_of(path: Path) -> int:
    """Of a file; one that has been renamed or removed meanwhile takes nothing."""
    try:
        return path.lstat().st_size
    except FileNotFoundError:
        return 0
