"""What a navigator has to say makes no thread of its flight wait, from beginning to end."""

import sys
from dataclasses import fields

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
