"""What a navigator has to say, and what it computes, makes no thread of its flight wait."""

import os
import sys
from dataclasses import fields

import cv2
import pytest

from vwnav.errors import ConfigError
from vwnav.machine.never_waits import NeverWaits
from vwnav.onboard import program, successor
from vwnav.onboard.options import FlyOptions

NAMES = [each.name for each in fields(FlyOptions)]


@pytest.mark.parametrize(("room", "begin"), [(program, "fly_route"), (successor, "stand_by")])
def test_whoever_flies_or_stands_by_waits_for_no_terminal(room, begin, monkeypatch):
    streams = []

    def plan_flight(*_: object) -> None:
        streams.append(sys.stderr)
        raise ConfigError("far enough")

    monkeypatch.setattr(room, "plan_flight", plan_flight)
    monkeypatch.setattr(room, "keep_heap_small", lambda: None)
    monkeypatch.setattr(program, "go_first", lambda: None)
    before = sys.stderr
    with pytest.raises(ConfigError):
        getattr(room, begin)(FlyOptions(**{**dict.fromkeys(NAMES), "sim": True}))
    assert isinstance(streams[0], NeverWaits)
    assert sys.stderr is before


@pytest.mark.parametrize(("room", "begin"), [(program, "fly_route"), (successor, "stand_by")])
def test_whoever_flies_or_stands_by_computes_in_short_turns_and_on_one_core_at_a_time(
    room, begin, monkeypatch
):
    found = []

    def plan_flight(*_: object) -> None:
        found.append((sys.getswitchinterval(), cv2.getNumThreads()))
        raise ConfigError("far enough")

    monkeypatch.setattr(room, "plan_flight", plan_flight)
    monkeypatch.setattr(room, "keep_heap_small", lambda: None)
    monkeypatch.setattr(os, "nice", lambda nicer: nicer)
    before = sys.getswitchinterval(), cv2.getNumThreads()
    sys.setswitchinterval(0.005)
    cv2.setNumThreads(2)
    try:
        with pytest.raises(ConfigError):
            getattr(room, begin)(FlyOptions(**{**dict.fromkeys(NAMES), "sim": True}))
    finally:
        sys.setswitchinterval(before[0])
        cv2.setNumThreads(before[1])
    [(turn_s, threads)] = found
    assert turn_s < 0.001
    assert threads == 1
