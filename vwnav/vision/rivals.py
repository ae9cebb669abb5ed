"""Which of the places that a search has found an image is at: the best, where none rivals it.

And whether a place has a rival in the same image, turned or with left and right exchanged.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Protocol, Self, TypeVar

from vwnav.geometry.rotations import wrap_pi
from vwnav.types import Array, Rejected, RejectReason
from vwnav.vision.candidates import MAX_RIVALRY, YAW_STEPS, Candidate, Hypothesis, hypotheses
from vwnav.vision.consensus import Consensus
from vwnav.vision.query import Query, View

SAME_HEIGHT = 0.05  # one sigma of a height that was found, as a share
FEW_SHARE = 0.2  # of the matches agree: of mirrored images at most as many, of most others more
REFINED_COARSE = 3  # of what a search found, the best
NO_OTHER = (RejectReason.AMBIGUOUS, RejectReason.MIRRORED)  # place of a search is believed then
KEPT_COARSE = 6  # while it goes on: two may prove to be one place


class _Found(Protocol):
    """What is asked of a `Registration` to hold it against others."""

    @property
    def candidate(self) -> Candidate: ...

    @property
    def consensus(self) -> Consensus: ...

    @property
    def hypothesis(self) -> Hypothesis: ...

    @property
    def view(self) -> View: ...

    def lat_lon_of_view(self, view_uv: Array) -> tuple[float, float]: ...

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
        elif rank == 0 or found.reason in NO_OTHER:
            refusal = found
    if not verified or refusal.reason in NO_OTHER:
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


def fits_mirrored(
    query: Query, found: Found, look: Callable[[Query, Candidate], Found | Rejected]
) -> Rejected | None:
    """A refusal where more of an image is on the map with left and right exchanged.

    A road is nearly the same mirrored: along it the matches of a mirrored image agree to a pixel,
    on a place beside the true one. Attitudes tell that pictures are mirrored; without them this.

    Args:
        query: of an image whose attitude is not known.
        found: where it seems to be.
        look: registers one of the candidates of a query.
    """
    consensus, agl_m = found.consensus, found.hypothesis.agl_m
    few = len(consensus.uv_view) < FEW_SHARE * consensus.matches
    if not (few or query.heading_open):
        return None
    view, mirrored = found.view.rectification, query.mirrored()
    lat_deg, lon_deg = found.lat_lon_of_view(found.view.center_uv)
    radius_m = max(max(view.size_wh) * view.m_per_px, found.candidate.radius_m)
    there = replace(found.candidate, lat_deg=lat_deg, lon_deg=lon_deg, radius_m=radius_m)
    prior = replace(query.prior, agl_m=agl_m, sigma_agl_ratio=SAME_HEIGHT)
    for hypothesis in hypotheses(prior, (agl_m, agl_m)):
        rival = look(mirrored, replace(there, hypothesis=hypothesis))
        if not isinstance(rival, Rejected) and rival.consensus.cells > consensus.cells:
            detail = (
                f"{len(consensus.uv_view)} matches agree, and {len(rival.consensus.uv_view)} once "
                "it is turned back: a flip in its driver or program, of one axis alone?"
            )
            return query.rejected(RejectReason.MIRRORED, detail)
    return None
