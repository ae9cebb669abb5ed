"""All rules."""

from vwnav.rules.belief import BELIEF
from vwnav.rules.commands import COMMANDS
from vwnav.rules.estimates import ESTIMATES
from vwnav.rules.mission import MISSION
from vwnav.rules.rule import Rule
from vwnav.rules.setpoints import SETPOINTS

RULES: tuple[Rule, ...] = (*SETPOINTS, *COMMANDS, *MISSION, *ESTIMATES, *BELIEF)
