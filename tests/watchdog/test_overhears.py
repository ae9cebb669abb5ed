"""What comes by on the link and is not meant for the watchdog, or means nothing."""

import pytest
from link_peer import PX4_LAND, PX4_POSITION
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from test_loop import TICK_S, Second, Stand, engaged, parsed

from vwnav.watchdog.keepalive import GuardState

OTHER = mavlink.MAVLink(None, srcSystem=9, srcComponent=1)


@pytest.mark.parametrize("mode", [PX4_POSITION, PX4_LAND])
def test_what_another_aircraft_flies_is_no_reason_to_leave_ours(mode):
    """Seen: its heartbeat, disarmed or in a pilot's mode, made the watchdog stand down."""

    def overheard(stand: Stand) -> None:
        for message in (
            mavlink.MAVLink_heartbeat_message(2, stand.kind, 1, mode, 4, 3),
            mavlink.MAVLink_extended_sys_state_message(0, 1),
            mavlink.MAVLink_command_ack_message(176, 2),
        ):
            stand.autopilot.arriving.append(bytes(message.pack(OTHER)))

    stand = engaged()
    stand.beating = False
    sent = stand.run(6.0, overheard)
    assert stand.watchdog.state is GuardState.LANDING
    assert {m.target_system for m in sent if "target_system" in m.get_fieldnames()} == {7}
    assert stand.mode == PX4_LAND


@pytest.mark.parametrize("system_id", [0, 7])
def test_a_spare_follows_the_navigators_autopilot_not_the_first_that_it_hears(system_id):
    """One that takes over in flight begins without having heard anything."""
    stand = Stand(successor=Second())
    stand.keepalive.system_id = system_id
    neighbour = mavlink.MAVLink_heartbeat_message(2, stand.kind, 1, PX4_POSITION, 4, 3)
    stand.autopilot.arriving.append(bytes(neighbour.pack(OTHER)))
    stand.watchdog.step(stand.t_s)
    stand.run(1.0)
    stand.beating = False
    stand.watchdog.handle_navigator_end(stand.t_s)
    stand.run(6.0)
    follows = system_id == 7
    assert (stand.watchdog.state is GuardState.LANDING) is follows
    assert (stand.mode == PX4_LAND) is follows


def test_a_successor_is_told_whom_to_follow():
    second = Second()
    stand = engaged(successor=second)
    stand.watchdog.handle_navigator_end(stand.t_s)
    stand.run(TICK_S)
    assert second.steps[-1].system_id == 7


def test_an_origin_that_was_told_before_its_time_is_asked_for_in_flight():
    """By a spare one: without it the last place means nothing to a successor."""

    def answers(stand: Stand) -> None:
        if any(is_question(each) for each in parsed(stand.autopilot.written)):
            stand.say(mavlink.MAVLink_gps_global_origin_message(411000000, 290000000, 40000))

    second = Second()
    stand = engaged(successor=second)
    asked = [each for each in stand.run(3.0) if is_question(each)]
    assert {each.target_system for each in asked} == {7}
    assert 2 <= len(asked) <= 4
    stand.run(0.1, answers)
    assert not any(map(is_question, stand.run(3.0)))
    stand.watchdog.handle_navigator_end(stand.t_s)
    stand.run(TICK_S)
    assert second.steps[-1].origin.lat_deg == pytest.approx(41.1)


def is_question(message) -> bool:
    return message.get_type() == "COMMAND_LONG" and (message.command, message.param1) == (512, 49)


def test_a_disarmed_aircraft_is_not_asked_for_its_origin():
    stand = Stand(successor=Second())
    stand.armed = False
    assert not any(map(is_question, stand.run(3.0)))


def test_an_origin_that_is_nowhere_is_not_handed_to_a_successor():
    second = Second()
    stand = engaged(successor=second)
    stand.say(mavlink.MAVLink_gps_global_origin_message(910000000, 290000000, 40000))
    stand.run(0.1)
    stand.beating = False
    stand.watchdog.handle_navigator_end(stand.t_s)
    stand.run(TICK_S)
    assert second.steps[-1].origin is None


def test_a_report_that_is_none_is_no_end_of_the_control_loop():
    stand = engaged()
    good = stand.keepalive.report
    stand.loop.arriving.append(b"VWR2\xff" + good.pack()[5:])
    stand.keepalive.beat(True)
    assert stand.keepalive.report == good
