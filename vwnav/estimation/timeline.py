"""Events in order of their own time, with the state after each; late ones go where they belong."""

import bisect
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from vwnav.estimation.events import Event, EventRank, rank_of
from vwnav.estimation.states import FilterState, States
from vwnav.estimation.updates import Innovation, Verdict

Apply = Callable[[FilterState, Event], tuple[FilterState, Innovation]]


@dataclass(slots=True)
class _Entry:
    order: tuple[float, EventRank]
    event: Event
    state: FilterState


class Timeline:
    """The last seconds of the filter.

    The state is always what it would be had every event come in order: inserting one applies all
    later ones again. But for its `reset_counter`, which others have seen: it never falls, and a
    past that has changed by so much that the newest position jumps counts too.
    """

    def __init__(self, start: FilterState, apply: Apply, length_s: float, jump_m: float) -> None:
        self._base = start
        self._apply = apply
        self._length_s = length_s
        self._jump_m = jump_m
        self._entries: list[_Entry] = []

    @property
    def head(self) -> FilterState:
        """The state after the newest event."""
        return self._entries[-1].state if self._entries else self._base

    @property
    def oldest_s(self) -> float:
        """Events before this time are too late."""
        return self._base.t_s

    def holds(self, t_s: float, rank: EventRank) -> bool:
        """Whether there is an event of that kind at that time."""
        i = self._place(t_s, rank)
        return i < len(self._entries) and self._entries[i].order == (t_s, rank)

    def keyframe_known(self, t_s: float) -> bool:
        """Whether a keyframe of that time is in the history or in the state before it."""
        anchor = self._base.anchor
        return self.holds(t_s, EventRank.ANCHOR) or (anchor is not None and anchor.t_s == t_s)

    def insert(self, event: Event) -> Innovation:
        """Apply an event at its time, and everything after it again."""
        if event.t_s < self._base.t_s:
            return Innovation(Verdict.TOO_LATE)
        if self.holds(event.t_s, rank_of(event)):
            return Innovation(Verdict.DUPLICATE)
        i = self._place(event.t_s, rank_of(event))
        told = self.head
        state, innovation = self._apply(self._before(i), event)
        self._entries.insert(i, _Entry((event.t_s, rank_of(event)), event, state))
        if i + 1 < len(self._entries):
            self._apply_again(i + 1, told)
        self._forget()
        return innovation

    def test(self, event: Event) -> Innovation:
        """What `insert` would say of an event, which is left out."""
        if event.t_s < self._base.t_s:
            return Innovation(Verdict.TOO_LATE)
        return self._apply(self._before(self._place(event.t_s, rank_of(event))), event)[1]

    def leave_out(self, *ranks: EventRank) -> None:
        """As if no event of these kinds had come in the history."""
        told = self.head
        self._entries = [entry for entry in self._entries if entry.order[1] not in ranks]
        self._apply_again(0, told)

    def _apply_again(self, i: int, told: FilterState) -> None:
        """The events from `i` on, now that the past is another; `told` was the newest state."""
        state = self._before(i)
        for entry in self._entries[i:]:
            state, _ = self._apply(state, entry.event)
            entry.state = state
        missing = told.reset_counter - state.reset_counter
        if missing >= 0 and _apart_m(told, state) > self._jump_m:
            missing += 1
        if missing > 0:
            self._count(missing)

    def _count(self, resets: int) -> None:
        """As if so many more had been before the history."""
        self._base = replace(self._base, reset_counter=self._base.reset_counter + resets)
        for entry in self._entries:
            state = entry.state
            entry.state = replace(state, reset_counter=state.reset_counter + resets)

    def _place(self, t_s: float, rank: EventRank) -> int:
        return bisect.bisect_left(self._entries, (t_s, rank), key=lambda entry: entry.order)

    def _before(self, i: int) -> FilterState:
        return self._entries[i - 1].state if i > 0 else self._base

    def _forget(self) -> None:
        limit_s = self._entries[-1].state.t_s - self._length_s
        count = bisect.bisect_left(self._entries, limit_s, key=lambda entry: entry.order[0])
        if count > 0:
            self._base = self._entries[count - 1].state
            del self._entries[:count]


def _apart_m(told: FilterState, state: FilterState) -> float:
    """Between two newest positions, of which one may be of an earlier moment."""
    flown_m = (state.t_s - told.t_s) * told.x[States.VELOCITY]
    return float(np.linalg.norm((state.x - told.x)[States.POSITION] - flown_m))
