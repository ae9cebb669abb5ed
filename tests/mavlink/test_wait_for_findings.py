"""A machine that is slow at its steps is not taken for a link that does not answer."""

import pytest

from vwnav.errors import LinkError
from vwnav.mavlink import mavsdk_autopilot
from vwnav.mavlink.mavsdk_autopilot import wait_for_findings


class SlowAutopilot:
    """Each step takes 0.3 s; after `needed` of them the parameters are read."""

    def __init__(self, clock, needed):
        self.clock, self.needed, self.findings = clock, needed, None

    def step(self, t_s):
        self.clock.now_s += 0.3
        self.needed -= 1
        if self.needed == 0:
            self.findings = ("read",)


class FakeTime:
    now_s = 0.0

    def monotonic(self):
        return self.now_s

    def sleep(self, span_s):
        self.now_s += span_s


@pytest.fixture
def clock(monkeypatch):
    made = FakeTime()
    monkeypatch.setattr(mavsdk_autopilot, "time", made)
    return made


def test_slow_steps_are_waited_for(clock):
    assert wait_for_findings(SlowAutopilot(clock, 60)) == ("read",)


def test_silence_is_not_waited_for_for_ever(clock):
    with pytest.raises(LinkError, match="answers no parameter request"):
        wait_for_findings(SlowAutopilot(clock, -1))
