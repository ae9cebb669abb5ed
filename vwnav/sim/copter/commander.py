"""Arming and the flight mode: who may change them, and when."""

import math

from vwnav.sim.copter.failsafes import CopterHealth, Say
from vwnav.sim.copter.modes import ARMABLE, NEEDS_POSITION, Mode
from vwnav.sim.copter.parameters import CopterParameters
from vwnav.sim.mavlink.command import Result, Severity

_CHECK_EVERY_S, _SAY_EVERY_S = 1.0, 30.0


class CopterCommander:
    """The vehicle's will.

    Attributes:
        mode: flown; `changes` counts how often it was set.
        armed: motors may turn, since `armed_s`.
        prearm_ok: as checked once a second.
    """

    def __init__(self, parameters: CopterParameters, say: Say) -> None:
        self._parameters = parameters
        self._say = say
        self.mode = Mode.STABILIZE
        self.changes = 0
        self.armed = False
        self.armed_s = -math.inf
        self.prearm_ok = False
        self._checked_s = self._said_s = -math.inf

    def problems(self, health: CopterHealth) -> tuple[str, ...]:
        """What it complains of before arming in this mode; () when its health shows it ready.

        That the mode itself is none to arm in is found only when that is asked for.
        """
        found = []
        if not health.attitude_ok:
            found.append("AHRS: not healthy")
        if self.mode in NEEDS_POSITION and not health.position_ok:
            found.append("Need Position Estimate")
        if int(self._parameters["VISO_TYPE"]) and not health.vision_ok:
            found.append("VisOdom: not healthy")
        if not health.settled:
            found.append("AHRS: waiting for home")
        if health.battery_level > 0:
            found.append("Battery failsafe")
        return tuple(found)

    def arm(self, health: CopterHealth, forced: bool, t_s: float) -> Result:
        """MAV_CMD_COMPONENT_ARM_DISARM 1."""
        if self.armed:
            return Result.ACCEPTED
        problems = self.problems(health)
        if self.mode not in ARMABLE:
            problems = (f"{self.mode.name.title()} mode not armable", *problems)
        if problems and not forced:
            self._say(Severity.CRITICAL, f"Arm: {problems[0]}")
            return Result.FAILED
        self.armed, self.armed_s = True, t_s
        self._say(Severity.INFO, "Arming motors")
        return Result.ACCEPTED

    def disarm(self, health: CopterHealth, forced: bool) -> Result:
        """MAV_CMD_COMPONENT_ARM_DISARM 0; in the air only by force."""
        if self.armed and not health.landed and not forced:
            return Result.FAILED
        self.stop()
        return Result.ACCEPTED

    def stop(self) -> None:
        """Motors off."""
        if self.armed:
            self.armed = False
            self._say(Severity.INFO, "Disarming motors")

    def begin_in_flight(self, mode: Mode, t_s: float) -> None:
        """Be armed and flying."""
        self.armed, self.armed_s = True, t_s
        self.mode = mode

    def ask(self, wanted: Mode, health: CopterHealth) -> Result:
        """Somebody asks for a mode; while armed it is refused without the position it needs."""
        lacks_position = wanted in NEEDS_POSITION and not health.may_hold
        if wanted is Mode.AUTO:
            return self._refuse(wanted, "no mission")
        if self.armed and lacks_position:
            return self._refuse(wanted, "requires position")
        self._change(wanted)
        return Result.ACCEPTED

    def force(self, wanted: Mode, health: CopterHealth) -> None:
        """A failsafe wants a mode: without the position that it needs, LAND."""
        self._change(Mode.LAND if wanted in NEEDS_POSITION and not health.may_hold else wanted)

    def _change(self, wanted: Mode) -> None:
        if wanted is not self.mode:
            self.mode = wanted
            self.changes += 1

    def _refuse(self, wanted: Mode, why: str) -> Result:
        self._say(Severity.WARNING, f"Mode change to {wanted.name} failed: {why}")
        return Result.FAILED

    def check(self, health: CopterHealth, t_s: float) -> None:
        """Once a second, while disarmed, say what forbids arming; the same only now and then."""
        if self.armed or t_s - self._checked_s < _CHECK_EVERY_S:
            return
        self._checked_s = t_s
        problems = self.problems(health)
        self.prearm_ok = not problems
        if problems and t_s - self._said_s >= _SAY_EVERY_S:
            self._said_s = t_s
            for problem in problems:
                self._say(Severity.CRITICAL, f"PreArm: {problem}")
