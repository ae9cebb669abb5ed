"""The control hierarchy (thesis, section 5.4): one table, read from the top.

The first rule that applies decides. One that stays goes on applying once it has. A landing that has
begun is ended by nobody but the pilot, and nobody returns on a position that leads nowhere.

`python -m vwnav.safety.hierarchy` prints the table as docs/flying.md has it.
"""

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from enum import Enum

from vwnav.safety.safety_config import SafetyConfig
from vwnav.safety.situation import BatteryLevel, Situation
from vwnav.vehicle import Order


class Rank(Enum):
    """Who decides, highest first."""

    PILOT = "pilot"
    BATTERY = "battery critical"
    SIGNAL = "signal loss"
    WAY_HOME = "way home"
    POSITION = "position bounds"
    OPERATOR = "ground station"
    NAVIGATION = "navigation"


class Action(Enum):
    """What may be done now."""

    NAVIGATE = "navigate"
    SLOW = "slow"
    HOLD = "hold"
    CLIMB = "climb"
    RETURN = "return"
    LAND = "land"
    YIELD = "yield"  # the autopilot flies a failsafe that may end by itself
    RELEASE = "release"


@dataclass(frozen=True, slots=True)
class Decision:
    """An action and why; `reason` is empty for NAVIGATE, and is what the pilot reads."""

    action: Action
    reason: str
    rank: Rank = Rank.NAVIGATION


Reason = Callable[[Situation, SafetyConfig], str | None]


@dataclass(frozen=True, slots=True, eq=False)
class SafetyRule:
    """A row: when it applies, in words with settings of `SafetyConfig` in braces, and what it asks.

    Attributes:
        reason: why it applies now; None when it does not.
        stays: it goes on applying with its first reason.
    """

    rank: Rank
    when: str
    action: Action
    reason: Reason
    stays: bool = False


def _released(now: Situation, config: SafetyConfig) -> str | None:
    return now.released


def _failsafe(now: Situation, config: SafetyConfig) -> str | None:
    if now.failsafe is None:
        return None
    if now.is_failsafe_told:
        return f"the autopilot flies its failsafe: {now.failsafe.value}"
    return f"the flight mode is {now.failsafe.value}: who chose it is not told yet"


def _battery_critical(now: Situation, config: SafetyConfig) -> str | None:
    return "battery critical" if now.battery is BatteryLevel.CRITICAL else None


def _silent_for_good(now: Situation, config: SafetyConfig) -> str | None:
    return "the autopilot has gone silent" if now.silence_s > config.link_land_s else None


def _silent(now: Situation, config: SafetyConfig) -> str | None:
    silent = now.silence_s > config.link_hold_s or not now.connected
    return "the autopilot is not heard" if silent else None


def _lost_for_good(now: Situation, config: SafetyConfig) -> str | None:
    return _lost(now, config) if now.lost_s >= config.lost_land_s else None


def _lost(now: Situation, config: SafetyConfig) -> str | None:
    return f"the estimate is lost: {now.lost}" if now.lost_s >= 0.0 else None


def _blind_for_good(now: Situation, config: SafetyConfig) -> str | None:
    return _blindness(now) if now.blind_s >= config.blind_land_s else None


def _never_right(now: Situation, config: SafetyConfig) -> str | None:
    """A camera whose pictures are mirrored is found out at take-off, a few metres up."""
    wrong = now.contradicted and not now.had_fix
    return "the camera shows what contradicts the IMU" if wrong else None


def _blind(now: Situation, config: SafetyConfig) -> str | None:
    return _blindness(now) if now.blind_s >= config.blind_hold_s else None


def _blindness(now: Situation) -> str:
    """A camera that comes late, or a computer that does, is another matter than what it shows."""
    if now.is_unseen:
        return "pictures are late or do not come"
    return "the camera shows nothing that can be followed"


def _way_home(now: Situation, config: SafetyConfig) -> str | None:
    """Why it is time to go home, whether that can be found or not."""
    if now.battery is BatteryLevel.LOW:
        return "battery low"
    if now.is_battery_for_home_only:
        return "the battery is just enough for the way home"
    if now.radio_lost_s > config.radio_return_s:
        return "the pilot's radio is lost"
    if now.ground_lost_s > config.ground_return_s:
        return "the ground station is lost"
    return None


def _home_is_below(now: Situation, config: SafetyConfig) -> str | None:
    return None if now.had_fix else _way_home(now, config)


def _off_the_route(now: Situation, config: SafetyConfig) -> str | None:
    beyond = now.off_route_m > config.fence_m
    return f"{now.off_route_m:.0f} m off the route" if beyond else None


def _carried_off(now: Situation, config: SafetyConfig) -> str | None:
    """By a wind that it does not make way against, as a rule: lower down there is less."""
    carried = now.carried_off_m > config.fence_m
    return f"carried off, {now.off_route_m:.0f} m from the route by now" if carried else None


def _nowhere(now: Situation, config: SafetyConfig) -> str | None:
    return None if now.is_usable else _bad_for(now, config.hold_time_s)


def _bad_after_climb(now: Situation, config: SafetyConfig) -> str | None:
    return _bad_for(now, config.hold_time_s)


def _bad_after_hold(now: Situation, config: SafetyConfig) -> str | None:
    return _bad_for(now, config.climb_after_s) if now.is_usable else None


def _bad(now: Situation, config: SafetyConfig) -> str | None:
    return _bad_for(now, 0.0)


def _bad_for(now: Situation, seconds: float) -> str | None:
    return now.complaint if now.bad_s >= seconds else None


def _poor(now: Situation, config: SafetyConfig) -> str | None:
    return now.warning or None


def _return_to_below(now: Situation, config: SafetyConfig) -> str | None:
    return None if now.had_fix else _ordered(Order.RETURN)(now, config)


def _ordered(order: Order) -> Reason:
    return lambda now, config: (
        f"the ground station asks for {order.value}" if now.order is order else None
    )


TABLE = (
    SafetyRule(Rank.PILOT, "the mode was changed, not by us", Action.RELEASE, _released),
    SafetyRule(
        Rank.PILOT, "the autopilot flies a failsafe, or has not said yet who chose its mode",
        Action.YIELD, _failsafe,
    ),
    SafetyRule(
        Rank.BATTERY, "battery below {battery_critical_ratio:.0%} for {battery_time_s:g} s",
        Action.LAND, _battery_critical, stays=True,
    ),
    SafetyRule(
        Rank.SIGNAL, "autopilot not heard for {link_land_s:g} s",
        Action.LAND, _silent_for_good, stays=True,
    ),
    SafetyRule(Rank.SIGNAL, "autopilot not heard for {link_hold_s:g} s", Action.HOLD, _silent),
    SafetyRule(
        Rank.SIGNAL, "no estimate to fly on for {lost_land_s:g} s",
        Action.LAND, _lost_for_good, stays=True,
    ),
    SafetyRule(Rank.SIGNAL, "no estimate to fly on", Action.HOLD, _lost),
    SafetyRule(
        Rank.SIGNAL, "no picture that tells motion or place for {blind_land_s:g} s",
        Action.LAND, _blind_for_good, stays=True,
    ),
    SafetyRule(
        Rank.SIGNAL, "pictures contradict the IMU, before the first fix", Action.LAND, _never_right,
        stays=True,
    ),
    SafetyRule(
        Rank.SIGNAL, "no picture that tells motion or place for {blind_hold_s:g} s",
        Action.HOLD, _blind,
    ),
    SafetyRule(
        Rank.WAY_HOME, "any of the next row before the first fix", Action.LAND, _home_is_below,
        stays=True,
    ),
    SafetyRule(
        Rank.WAY_HOME,
        "battery below {battery_low_ratio:.0%} for {battery_time_s:g} s, or what is left above "
        "{battery_critical_ratio:.0%} is less than {battery_home_share:g} times what the way home "
        "takes in the wind; the pilot's radio, once heard, lost for {radio_return_s:g} s; the "
        "ground station likewise for {ground_return_s:g} s",
        Action.RETURN, _way_home, stays=True,
    ),
    SafetyRule(
        Rank.POSITION, "off the route (next row), and carried off by {fence_m:g} m more, from home "
        "too",
        Action.LAND, _carried_off, stays=True,
    ),
    SafetyRule(
        Rank.POSITION, "{fence_m:g} m off the route and the way home", Action.RETURN,
        _off_the_route, stays=True,
    ),
    SafetyRule(
        Rank.POSITION,
        "out of bounds (below) for {hold_time_s:g} s and uncertain by "
        "{return_sigma_m:g} m",
        Action.LAND, _nowhere, stays=True,
    ),
    SafetyRule(
        Rank.POSITION, "out of bounds for {hold_time_s:g} s", Action.RETURN, _bad_after_climb,
        stays=True,
    ),
    SafetyRule(Rank.POSITION, "out of bounds for {climb_after_s:g} s", Action.CLIMB,
         _bad_after_hold),
    SafetyRule(
        Rank.POSITION,
        "out of bounds: uncertain by {hold_sigma_m:g} m, or no map fix for {hold_fix_age_s:g} s",
        Action.HOLD, _bad,
    ),
    SafetyRule(Rank.OPERATOR, "it asks to land", Action.LAND, _ordered(Order.LAND), stays=True),
    SafetyRule(
        Rank.OPERATOR, "it asks to return before the first fix", Action.LAND, _return_to_below,
        stays=True,
    ),
    SafetyRule(Rank.OPERATOR, "it asks to pause, until it asks to go on", Action.HOLD,
         _ordered(Order.PAUSE)),
    SafetyRule(Rank.OPERATOR, "it asks to return", Action.RETURN,
         _ordered(Order.RETURN), stays=True),
    # Last: who only flies slower would hide whatever stands below it.
    SafetyRule(
        Rank.POSITION, "uncertain by {slow_sigma_m:g} m, or no map fix for {slow_fix_age_s:g} s",
        Action.SLOW, _poor,
    ),
)  # fmt: skip

_DOES = {
    Action.NAVIGATE: "flies the route",
    Action.SLOW: "goes on at half speed",
    Action.HOLD: "zero velocity",
    Action.CLIMB: "climbs, {climb_most_m:g} m at most, to where the map shows more",
    Action.RETURN: "returns: up to {return_height_m:g} m above home where it is lower, more where "
    "the map's ground on the shortest way home asks for it, then home by that way, or along the "
    "flown way where the position is poor or that ground too high for the ceiling",
    Action.LAND: "Land, here",
    Action.YIELD: "commands nothing; see section 5 for what follows",
    Action.RELEASE: "commands nothing until the motors stop; estimates go on",
}


class Hierarchy:
    """The table, and which of its rules stay."""

    def __init__(self, config: SafetyConfig) -> None:
        self._config = config
        self._standing: dict[SafetyRule, str] = {}

    def step(self, now: Situation) -> Decision:
        """The decision for a situation; to be called at every tick."""
        found: list[tuple[SafetyRule, str]] = []
        for rule in TABLE:
            reason = self._standing.get(rule) or rule.reason(now, self._config)
            if rule.action is Action.RETURN and not now.is_usable:
                continue
            if reason is None:
                continue
            if rule.stays and not (found and found[0][0].rank is Rank.PILOT):
                self._standing[rule] = reason
            found.append((rule, reason))
        if not found:
            return Decision(Action.NAVIGATE, "")
        rule, reason = next((each for each in found if self._lands(each[0], found)), found[0])
        return Decision(rule.action, reason, rule.rank)

    def lands_for(self, now: Situation) -> str | None:
        """Why it would be landed, whoever has it now; None where it would not.

        Held for a signal that is lost, too: that ends in a landing seconds later.
        """
        rules = (rule for rule in TABLE if rule.action is Action.LAND or rule.rank is Rank.SIGNAL)
        reasons = (self._standing.get(rule) or rule.reason(now, self._config) for rule in rules)
        return next((reason for reason in reasons if reason is not None), None)

    def _lands(self, rule: SafetyRule, found: list[tuple[SafetyRule, str]]) -> bool:
        """A landing goes before all but the pilot."""
        return rule.action is Action.LAND and found[0][0].rank is not Rank.PILOT


def as_markdown(config: SafetyConfig) -> str:
    """The table for docs/flying.md."""
    lines = ["| who decides | when | what it does |", "|---|---|---|"]
    settings = {name: value for name, value in asdict(config).items() if math.isfinite(value)}
    for rule in TABLE:
        stays = ", for good" if rule.stays else ""
        does = _DOES[rule.action].format(**settings) + stays
        lines.append(f"| {rule.rank.value} | {rule.when.format(**settings)} | {does} |")
    return "\n".join([*lines, f"| {Rank.NAVIGATION.value} | else | {_DOES[Action.NAVIGATE]} |"])


if __name__ == "__main__":
    print(as_markdown(SafetyConfig()))
