"""Started again while the aircraft flies: beside the watchdog of the flight that broke off.

That one holds, brakes and lands, and its second navigator tells the autopilot where it is: there is
one who commands and one who tells, and this one is neither. When the aircraft is disarmed they
leave, and it gets ready for a flight; a person gives it the aircraft then, by arming.
"""

from vwnav.onboard.service import ServiceManager
from vwnav.screen import say
from vwnav.watchdog.visitors import visit

_COMMANDS_NOTHING = "this one commands nothing, and gets ready once the aircraft is disarmed"


def wait_for_the_aircraft(connection: str, manager: ServiceManager) -> bool:
    """Wait until the watchdog of a navigator that has ended leaves; False where there is none.

    Where its navigator lives there is nothing to wait for: the link is taken.

    Args:
        connection: URL of the autopilot's link.
        manager: of the services, who would take the wait for a start that hangs.

    Raises:
        LinkError: that watchdog hangs.
    """
    words, waited = "", False
    for guarding in visit(connection):
        if not guarding.navigator_ended:
            return False
        manager.live(f"beside the last flight's watchdog: {guarding.words}")
        if guarding.armed and words != guarding.words:
            words, waited = guarding.words, True
            say(f"the aircraft flies: joined {words}; {_COMMANDS_NOTHING}")
    if waited:
        say("its watchdog has left: getting ready, and a person arms")
    return waited
