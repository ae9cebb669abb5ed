"""Which of the places that a search has found an image is at: the best, where none rivals it."""

from collections.abc import Callable
from typing import Protocol, Self, TypeVar

from vwnav.types import Rejected, RejectReason
from vwnav.vision.candidates import MAX_RIVALRY
from vwnav.vision.consensus import Consensus
from vwnav.vision.query import Query

REFINED_COARSE = 3  # of what a search found, the best


class _Found(Protocol):
    """What is asked of a `Registration` to hold it against others."""

    @property
    def consensus(self) -> Consensus: ...

    def is_place_of(self, other: Self) -> bool: ...


Found = TypeVar("Found", bound=_Found)


def best_of(
    query: Query,
    coarse: list[Found],
    tests: int,
    closer: Callable[[Found], Found | Rejected],
) -> Found | Rejected:
    """The best of what a search found, refined and verified, if no other place is as good.

    Args:
        query: what was searched for.
        coarse: what was found, in any order.
        tests: looks that the search took.
        closer: refines and verifies one of them.
    """
    refusal = query.rejected(
        RejectReason.FEW_INLIERS, f"nothing like it on the map ({tests} looks)"
    )
    verified: list[Found] = []
    tried: list[Found] = []
    for hit in sorted(coarse, key=lambda each: each.consensus.log10_nfa):
        if any(hit.is_place_of(other) for other in tried):
            continue
        tried.append(hit)
        found = closer(hit)
        if not isinstance(found, Rejected):
            verified.append(found)
        elif len(tried) == 1 or found.reason is RejectReason.AMBIGUOUS:
            refusal = found
        if len(tried) == REFINED_COARSE:
            break
    if not verified or refusal.reason is RejectReason.AMBIGUOUS:
        return refusal
    best, *rivals = sorted(verified, key=lambda each: each.consensus.log10_nfa)
    for rival in rivals:
        strong = rival.consensus.cells >= MAX_RIVALRY * best.consensus.cells
        if strong and not best.is_place_of(rival):
            detail = "two places on the map fit as well"
            return query.rejected(RejectReason.AMBIGUOUS, detail)
    return best
