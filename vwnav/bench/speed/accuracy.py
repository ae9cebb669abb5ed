"""How well a setting finds places, as it was measured on a real flight; not on the board."""

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from vwnav.bench.speed.settings import Setting

_SAME = 0.05
PATH = Path(__file__).with_name("accuracy.json")  # `flown_accuracy` measures it anew


@dataclass(frozen=True, slots=True)
class Accuracy:
    """Of one feature set at one resolution with so many keypoints.

    Attributes:
        within_3_m: share of the images that are placed so.
        inliers: mean number of pairs that agree about the place.
    """

    within_3_m: float
    inliers: float

    @property
    def merit(self) -> tuple[int, float]:
        """More is better: places first; an image or two of 60 are no difference, inliers are."""
        return round(self.within_3_m / _SAME), self.inliers


@cache
def _table() -> dict[str, Any]:
    content: dict[str, Any] = json.loads(PATH.read_text())
    return content


def source() -> str:
    """Where the figures are from."""
    return str(_table()["source"])


def accuracy_of(setting: Setting, feature_set_id: str) -> Accuracy | None:
    """What was measured; None for other weights than those that were."""
    measured_id = _table()["weights"].get(setting.label)
    if setting.features.name == "learned" and measured_id != feature_set_id:
        return None
    asked = {"features": setting.label, "size": setting.size, "keypoints": setting.keypoints}
    for row in _table()["rows"]:
        if asked.items() <= row.items():
            return Accuracy(row["within_3_m"], row["inliers"])
    return None
