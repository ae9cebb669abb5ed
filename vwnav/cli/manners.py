"""The option --manners of commands that fly the built-in vehicle."""

from typing import get_args

from vwnav.errors import ConfigError
from vwnav.sim.config import Manners


def manners_of(text: str) -> Manners:
    """Whose ways the vehicle has.

    Raises:
        ConfigError: no vehicle has these.
    """
    known: tuple[Manners, ...] = get_args(Manners)
    for each in known:
        if each == text:
            return each
    raise ConfigError(f"--manners is {' or '.join(known)}, not {text!r}")
