"""Single messages over a link in memory, as MAVSDK's JSON would have them."""

import math

import pytest
from autopilot_links import Clock, End, Way
from pymavlink.dialects.v20 import all as mavlink

from vwnav.mavlink.ports.pymavlink_port import PymavlinkPort


@pytest.fixture
def link():
    clock = Clock()
    down, up = Way(clock), Way(clock)
    return PymavlinkPort(End(down, up), clock), down, up


def packed(message, system_id=7, component_id=1):
    sender = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=component_id)
    return bytes(message.pack(sender))


def beat(autopilot=12):
    return mavlink.MAVLink_heartbeat_message(2, autopilot, 0, 0, 4, 3)


def heard(port, name):
    fields = []
    port.subscribe(name, lambda _, each, __: fields.append(each))
    return fields


def sent(up):
    data = b"".join(iter(up.read, b""))
    return mavlink.MAVLink(None).parse_buffer(data)


def test_the_first_autopilot_is_the_one_and_a_gimbal_is_none(link):
    port, down, _ = link
    beats = heard(port, "HEARTBEAT")
    assert port.system_id == 0
    for message in (
        packed(beat(8), 3),  # a gimbal
        packed(beat(), 4, 190),  # a ground station's component
        packed(beat(), 7),
        packed(beat(3), 9),
    ):
        down.write(message)
    port.poll()
    assert port.system_id == 7
    assert len(beats) == 1


def test_a_heartbeat_of_another_component_makes_no_autopilot_though_it_is_listened_to(link):
    port, down, _ = link
    port.listen("HEARTBEAT", lambda *_: None)
    beats = heard(port, "HEARTBEAT")
    for message in (packed(beat(), 4, 190), packed(beat(), 7)):
        down.write(message)
    port.poll()
    assert port.system_id == 7
    assert len(beats) == 1


def test_nan_is_none_and_arrays_are_lists(link):
    port, down, _ = link
    heard(port, "HEARTBEAT")
    fields = heard(port, "DISTANCE_SENSOR")
    down.write(packed(beat()))
    message = mavlink.MAVLink_distance_sensor_message(
        1, 2, 3, 4, 0, 0, 25, 0, math.nan, 0.5, [1.0, math.nan, 0.0, 0.0]
    )
    down.write(packed(message))
    port.poll()
    assert fields[0]["horizontal_fov"] is None
    assert fields[0]["vertical_fov"] == 0.5
    assert fields[0]["quaternion"] == [1.0, None, 0.0, 0.0]


def test_what_is_sent_is_what_was_meant(link):
    port, _, up = link
    port.send("PARAM_SET", {"target_system": 7, "param_id": "MIS_TAKEOFF_ALT", "param_value": None})
    port.send("STATUSTEXT", {"severity": 4, "text": "hello"})
    covariance = [0.5] * 20 + [None]
    port.send("VISION_POSITION_ESTIMATE", {"usec": 5, "x": 1.5, "covariance": covariance})
    parameter, text, position = sent(up)
    assert (parameter.param_id, parameter.target_system) == ("MIS_TAKEOFF_ALT", 7)
    assert math.isnan(parameter.param_value)
    assert text.text == "hello"
    assert (position.usec, position.x, position.y) == (5, 1.5, 0.0)
    assert position.covariance[:20] == [0.5] * 20
    assert math.isnan(position.covariance[20])


@pytest.mark.parametrize(("name", "fields"), [("NO_SUCH", {}), ("TIMESYNC", {"tc2": 1})])
def test_a_message_or_field_that_does_not_exist_is_a_mistake(link, name, fields):
    with pytest.raises(ValueError, match="no"):
        link[0].send(name, fields)


def test_garbage_between_packets_and_halves_of_packets_are_survived(link):
    port, down, _ = link
    beats = heard(port, "HEARTBEAT")
    data = b"\x00\xfdgarbage" + packed(beat()) * 20 + b"\xff\xff" + packed(beat()) * 20
    for byte in data:
        down.write(bytes([byte]))
    broken = bytearray(packed(beat()))
    broken[12] ^= 0xFF
    down.write(bytes(broken))
    down.write(packed(beat()))
    port.poll()
    assert len(beats) > 30  # a start byte in garbage swallows what its length says


def test_a_companion_says_once_a_second_that_it_is_here(link):
    port, _, up = link
    for _ in range(30):
        port._clock.t_s += 0.1
        port.poll()
    assert [m.get_type() for m in sent(up)] == ["HEARTBEAT"] * 3
    port.close()
    port.send("HEARTBEAT", {})
    port._clock.t_s += 5.0
    port.poll()
    assert not sent(up)


def test_a_target_is_ours_everybodys_or_not_told(link):
    port = link[0]
    assert port.is_for_us({})
    assert port.is_for_us({"target_system": 0, "target_component": 0})
    assert port.is_for_us({"target_system": 245, "target_component": 191})
    assert not port.is_for_us({"target_system": 245, "target_component": 1})
    assert not port.is_for_us({"target_system": 7, "target_component": 191})
