"""What came of the looks, counted."""

import math
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import chain

import numpy as np

from vwnav.bench.localizer.looks import LOOK_KINDS, LookCase, LookKind
from vwnav.geometry.geodesy import LocalFrame
from vwnav.geometry.rotations import wrap_pi
from vwnav.types import MapFix, Rejected

RIGHT = 8.0  # units, pixels of the map or metres: what is nearer is located
RIGHT_YAW_RAD = math.radians(15.0)  # a fix turned by more is wrong, whatever its place
CHI2_95 = 5.991  # of two degrees of freedom
_DOUBT = 0.05


@dataclass(frozen=True, slots=True)
class Outcome:
    """One look and what the localizer said.

    Attributes:
        reason: of a rejection; None for a fix.
        error: distance from the truth in the look's units; None without a fix or a truth.
        nees: squared error over the fix's covariance and that of the label; as `error`.
        turned: the heading is wrong.
        sigma: of the fix, units.
        inliers: of the fix or of what was refused.
        cpu_s: processor time of the look.
    """

    group: str
    name: str
    kind: LookKind
    reason: str | None
    error: float | None
    nees: float | None
    turned: bool
    sigma: float | None
    inliers: int
    cpu_s: float

    @property
    def fixed(self) -> bool:
        """Whether there is a fix."""
        return self.reason is None

    @property
    def located(self) -> bool:
        """A fix at the right place."""
        return self.error is not None and self.error <= RIGHT and not self.turned

    @property
    def false(self) -> bool:
        """A fix where the map does not show the place, or far off and sure of it, or turned."""
        if not self.fixed or self.located:
            return False
        return self.turned or self.nees is None or self.nees > CHI2_95


@dataclass(frozen=True, slots=True, kw_only=True)
class LookScore:
    """Of many looks of one kind.

    Attributes:
        looks: how many.
        located: share of them with a fix at the right place; None where there is none.
        held: fixes further off, but within their own 95 % ellipse.
        false: fixes that mislead.
        false_bound: upper 95 % bound of their share.
        rejected: rejections by reason.
        error_median, error_95: of the fixes at the right place, units.
        nees: mean over them; 2 is honest.
        inside: share of them inside the 95 % ellipse.
        worst_sigmas: the largest error of them in its own sigmas.
        per_s: looks in a second of processor time.
    """

    looks: int
    located: float | None
    held: int
    false: int
    false_bound: float
    rejected: dict[str, int]
    error_median: float | None
    error_95: float | None
    nees: float | None
    inside: float | None
    worst_sigmas: float | None
    per_s: float


def judge(look: LookCase, said: MapFix | Rejected, cpu_s: float) -> Outcome:
    """Hold what the localizer said against the truth."""
    error = nees = sigma = None
    turned = False
    if isinstance(said, MapFix):
        sigma = said.sigma_m / look.unit_m
        if look.truth is not None:
            frame = LocalFrame(look.truth.lat_deg, look.truth.lon_deg, 0.0)
            off_ne_m = frame.to_ned(said.lat_deg, said.lon_deg, 0.0)[:2]
            error = float(np.linalg.norm(off_ne_m)) / look.unit_m
            covariance_m2 = said.covariance_ne_m2 + look.label_m**2 * np.eye(2)
            nees = float(off_ne_m @ np.linalg.solve(covariance_m2, off_ne_m))
            if said.yaw_rad is not None:
                turned = abs(wrap_pi(said.yaw_rad - look.truth.yaw_rad)) > RIGHT_YAW_RAD
    return Outcome(
        group=look.group,
        name=look.name,
        kind=look.kind,
        reason=said.reason.name.lower() if isinstance(said, Rejected) else None,
        error=error,
        nees=nees,
        turned=turned,
        sigma=sigma,
        inliers=said.stats.inliers,
        cpu_s=cpu_s,
    )


def score(outcomes: Iterable[Outcome]) -> LookScore:
    """Count; `outcomes` holds at least one."""
    every = list(outcomes)
    right = [each for each in every if each.located]
    errors = [each.error for each in right if each.error is not None]
    nees = [each.nees for each in right if each.nees is not None]
    false = sum(each.false for each in every)
    shown = every[0].kind in ("prior", "search")
    return LookScore(
        looks=len(every),
        located=len(right) / len(every) if shown else None,
        held=sum(each.fixed and not each.located and not each.false for each in every),
        false=false,
        false_bound=upper_bound(false, len(every)),
        rejected=dict(Counter(each.reason for each in every if each.reason).most_common()),
        error_median=float(np.median(errors)) if errors else None,
        error_95=float(np.percentile(errors, 95)) if errors else None,
        nees=float(np.mean(nees)) if nees else None,
        inside=float(np.mean(np.array(nees) <= CHI2_95)) if nees else None,
        worst_sigmas=math.sqrt(max(nees)) if nees else None,
        per_s=len(every) / max(sum(each.cpu_s for each in every), 1e-9),
    )


def upper_bound(seen: int, of: int) -> float:
    """The share that `seen` of `of` may stand for, 95 % sure (Clopper and Pearson 1934)."""
    low, high = seen / of, 1.0
    for _ in range(60):
        middle = (low + high) / 2.0
        at_most = (
            sum(
                math.exp(
                    math.lgamma(of + 1)
                    - math.lgamma(k + 1)
                    - math.lgamma(of - k + 1)
                    + k * math.log(middle)
                    + (of - k) * math.log1p(-middle)
                )
                for k in range(seen + 1)
            )
            if 0.0 < middle < 1.0
            else float(middle <= 0.0)
        )
        low, high = (middle, high) if at_most > _DOUBT else (low, middle)
    return high


@dataclass(frozen=True, slots=True, eq=False)
class LocalizerReport:
    """Attributes: what came of every look, by feature set."""

    outcomes: dict[str, list[Outcome]]

    def scores(self) -> Iterator[tuple[str, LookKind, dict[str, LookScore]]]:
        """By group, by kind and by feature set; a kind's groups together come last, as "all"."""
        everything = list(chain(*self.outcomes.values()))
        groups = list(dict.fromkeys(each.group for each in everything))
        for kind in LOOK_KINDS:
            of_kind = [
                g for g in groups if any(e.group == g and e.kind == kind for e in everything)
            ]
            for group in [*of_kind, ALL] if len(of_kind) > 1 else of_kind:
                chosen = {
                    name: [e for e in each if e.kind == kind and group in (ALL, e.group)]
                    for name, each in self.outcomes.items()
                }
                yield group, kind, {name: score(e) for name, e in chosen.items() if e}


ALL = "all"


@dataclass(frozen=True, slots=True, kw_only=True)
class ShortFlightOutcome:
    """What came of a flight.

    Attributes:
        kind: of its looks.
        alone, joined: number of the first image with a right fix, from 1; None without one.
        alone_false, joined_false: fixes that mislead, see `Outcome.false`.
    """

    group: str
    name: str
    kind: LookKind
    alone: int | None
    joined: int | None
    alone_false: int
    joined_false: int


@dataclass(frozen=True, slots=True, kw_only=True)
class SequenceTally:
    """Of many flights.

    Attributes:
        alone, joined: how many of them had a right fix.
        alone_first, joined_first: number of the image that gave the first one, mean of those.
        alone_false, joined_false: fixes that mislead.
    """

    group: str
    kind: LookKind
    flights: int
    alone: int
    joined: int
    alone_first: float | None
    joined_first: float | None
    alone_false: int
    joined_false: int


def sequence_scores(outcomes: list[ShortFlightOutcome]) -> Iterator[SequenceTally]:
    """By kind of look and by group."""
    for kind in LOOK_KINDS:
        of_kind = [each for each in outcomes if each.kind == kind]
        for group in dict.fromkeys(each.group for each in of_kind):
            yield _tally(group, kind, [each for each in of_kind if each.group == group])


def _tally(group: str, kind: LookKind, flights: list[ShortFlightOutcome]) -> SequenceTally:
    alone = [each.alone for each in flights if each.alone is not None]
    joined_ = [each.joined for each in flights if each.joined is not None]
    return SequenceTally(
        group=group,
        kind=kind,
        flights=len(flights),
        alone=len(alone),
        joined=len(joined_),
        alone_first=float(np.mean(alone)) if alone else None,
        joined_first=float(np.mean(joined_)) if joined_ else None,
        alone_false=sum(each.alone_false for each in flights),
        joined_false=sum(each.joined_false for each in flights),
    )
