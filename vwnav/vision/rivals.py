"""Which of the places that a search has found an image is at: the best, where none rivals it."""

import math
from collections.abc import Callable
from typing import Protocol, Self, TypeVar

from vwnav.geometry.rotations import wrap_pi
from vwnav.types import Rejected, RejectReason
from vwnav.vision.candidates import MAX_RIVALRY, YAW_STEPS, Candidate, Hypothesis
from vwnav.vision.consensus import Consensus
from vwnav.vision.query import Query

REFINED_COARSE = 3  # of what a search found, the best
KEPT_COARSE = 6  # while it goes on: two may prove to be one place


class _Found(Protocol):
    """What is asked of a `Registration` to hold it against others."""

    @property
    def candidate(self) -> Candidate: ...

    @property
    def consensus(self) -> Consensus: ...

    @property
    def hypothesis(self) -> Hypothesis: ...

    def is_place_of(self, other: Self) -> bool: ...


Found = TypeVar("Found", bound=_Found)


def best_apart(hits: list[Found]) -> list[Found]:
    """The best of them at places of their own, best first.

    Each holds the features of its piece of the map: a search of a large one may not keep them all.
    """
    apart: list[Found] = []
    for hit in sorted(hits, key=lambda each: each.consensus.log10_nfa):
        if not any(hit.is_place_of(other) for other in apart):
            apart.append(hit)
    return apart[:KEPT_COARSE]


def best_of(
    query: Query,
    places: list[Found],
    tests: int,
    closer: Callable[[Found], Found | Rejected],
) -> Found | Rejected:
    """The best of what a search found, refined and verified, if no other place is as good.

    Args:
        query: what was searched for.
        places: what was found, as `best_apart` keeps it.
        tests: looks that the search took.
        closer: refines and verifies one of them.
    """
    refusal = query.rejected(
        RejectReason.FEW_INLIERS, f"nothing like it on the map ({tests} looks)"
    )
    verified: list[Found] = []
    for rank, hit in enumerate(places[:REFINED_COARSE]):
        found = closer(hit)
        if not isinstance(found, Rejected):
            verified.append(found)
        elif rank == 0 or found.reason is RejectReason.AMBIGUOUS:
            refusal = found
    if not verified or refusal.reason is RejectReason.AMBIGUOUS:
        return refusal
    best, *rivals = sorted(verified, key=lambda each: each.consensus.log10_nfa)
    for rival in rivals:
        strong = rival.consensus.cells >= MAX_RIVALRY * best.consensus.cells
        if strong and not best.is_place_of(rival):
            detail = "two places on the map fit as well"
            return query.rejected(RejectReason.AMBIGUOUS, detail)
    return best


def elsewhere_turned(
    query: Query,
    hit: Found,
    candidates: list[Candidate],
    look: Callable[[Candidate], Found | Rejected],
) -> Rejected | None:
    """A refusal where another part of the map shows nearly as much of the image, turned.

    The first place that is sure ends a search: which end of a runway that is, is chance.

    Args:
        query: what was searched for.
        hit: the place that ends it, as the search saw it.
        candidates: all that it would look at.
        look: registers one of them.
    """
    yaw_rad, agl_m = hit.hypothesis.yaw_rad, hit.candidate.hypothesis.agl_m
    for each in (each for each in candidates if each.hypothesis.agl_m == agl_m):
        turn_rad = wrap_pi(each.hypothesis.yaw_rad - yaw_rad)
        off_rad = abs(wrap_pi(4.0 * turn_rad)) / 4.0  # the nearest quarter
        if abs(turn_rad) < math.pi / 4.0 or off_rad > math.pi / YAW_STEPS:
            continue
        rival = look(each)
        if isinstance(rival, Rejected):
            continue
        if rival.consensus.cells >= MAX_RIVALRY * hit.consensus.cells:
            detail = "another place on the map fits as well, turned by a quarter or a half"
            return query.rejected(RejectReason.AMBIGUOUS, detail)
    return None
