"""Recordings of MAVLink: damaged, of several starts, of several autopilots."""

import gzip
import struct
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from vwnav.errors import SourceError
from vwnav.geometry.rotations import euler_from_rotation, rotation_from_quat
from vwnav.recording.telemetry_files import load_telemetry
from vwnav.types import Attitude, Height

COUNT = 100  # attitudes of a flight, ten a second
HEIGHTS = COUNT - 9  # the first ten pressures are what they count from


def entry(sender: mavlink.MAVLink, message: mavlink.MAVLink_message) -> bytes:
    """A stamp of eight bytes that begins no packet, and the packet."""
    return struct.pack(">Q", 1_700_000_000_000_000) + message.pack(sender)


def flight(
    begins_s: float, yaw_rad: float = 0.0, system: int = 1, count: int = COUNT
) -> list[bytes]:
    """Rows of an attitude and a pressure."""
    sender = mavlink.MAVLink(None, system, 1)
    rows = []
    for i in range(count):
        t_ms = round(begins_s * 1e3) + 100 * i
        attitude = mavlink.MAVLink_attitude_message(t_ms, 0.1, 0.0, yaw_rad, 0.0, 0.0, 0.0)
        pressure = mavlink.MAVLink_scaled_pressure_message(t_ms, 1000.0 - 0.1 * i, 0.0, 0)
        rows.append(entry(sender, attitude) + entry(sender, pressure))
    return rows


def read(tmp_path: Path, rows: list[bytes]) -> tuple[list[Attitude], list[Height]]:
    path = tmp_path / "flight.tlog"
    path.write_bytes(b"".join(rows))
    log = load_telemetry(path)
    told = log.measurements(log.start_s)
    return tuple([seen for seen in told if isinstance(seen, kind)] for kind in (Attitude, Height))


def yaw_rad(attitude: Attitude) -> float:
    return euler_from_rotation(rotation_from_quat(attitude.quat_wxyz))[2]


@pytest.mark.parametrize("byte", [8, 9, 12, 30])  # marker, length, number, payload
@pytest.mark.parametrize("row", [0, 10])
def test_a_damaged_byte_costs_one_packet_and_is_said(tmp_path, caplog, byte, row):
    rows = flight(5.0)
    damaged = bytearray(rows[row])
    damaged[byte] ^= 0x55
    rows[row] = bytes(damaged)
    attitudes, heights = read(tmp_path, rows)
    assert len(heights) == HEIGHTS
    assert COUNT - 1 <= len(attitudes) <= COUNT  # a wrong number in a packet is no damage to it
    assert attitudes[-1].t_s == pytest.approx(14.9)
    assert (len(attitudes) == COUNT - 1) == ("bytes are damaged" in caplog.text)


def test_a_page_that_was_never_written_is_skipped(tmp_path, caplog):
    data = b"".join(flight(5.0))
    attitudes, _ = read(tmp_path, [data[:2000], bytes(1000), data[3000:]])
    assert len(attitudes) > 0.7 * COUNT
    assert attitudes[-1].t_s == pytest.approx(14.9)
    (skipped,) = (int(record.args[1]) for record in caplog.records)
    assert 1000 <= skipped < 1200


def test_a_whole_tlog_is_read_in_silence(tmp_path, caplog):
    attitudes, heights = read(tmp_path, flight(5.0))
    assert (len(attitudes), len(heights)) == (COUNT, HEIGHTS)
    assert not caplog.records


@pytest.mark.parametrize("first", [True, False])
def test_of_two_starts_the_longer_is_taken_and_it_is_said(tmp_path, caplog, first):
    long = flight(5.0, yaw_rad=-1.0)
    short = flight(3.0 if first else 60.0, yaw_rad=1.0, count=20)
    attitudes, heights = read(tmp_path, long + short if first else short + long)
    assert (len(attitudes), len(heights)) == (COUNT, HEIGHTS)
    assert {round(yaw_rad(seen), 6) for seen in attitudes} == {-1.0}
    assert attitudes[0].t_s == pytest.approx(5.0)
    assert f"number {1 if first else 2}, of system 1, 10 s" in caplog.text


def test_two_autopilots_in_one_file_are_not_mixed(tmp_path, caplog):
    one, other = flight(5.0, yaw_rad=-1.0), flight(40.0, yaw_rad=1.0, system=2)
    mixed = [row for pair in zip(one, other[:-1], strict=False) for row in pair]
    attitudes, _ = read(tmp_path, [*mixed, one[-1]])
    assert {round(yaw_rad(seen), 6) for seen in attitudes} == {-1.0}
    assert "2 starts of autopilots" in caplog.text


def test_a_packet_that_overtook_another_begins_no_new_run(tmp_path, caplog):
    rows = flight(5.0)
    rows[50], rows[51] = rows[51], rows[50]
    attitudes, _ = read(tmp_path, rows)
    assert attitudes[-1].t_s == pytest.approx(14.9)
    assert "2 measurements left out, whose time is not of those about them" in caplog.text


def test_one_packet_that_is_seconds_late_begins_no_new_start(tmp_path):
    rows = flight(10.0)
    rows.insert(60, rows[5])
    attitudes, _ = read(tmp_path, rows)
    assert len(attitudes) == COUNT


def test_a_second_link_that_is_seconds_late_begins_no_new_start(tmp_path):
    """Radio and telephone network in one file."""
    rows, late = flight(10.0), flight(10.0)
    mixed = rows[:30] + [row for pair in zip(rows[30:], late, strict=False) for row in pair]
    attitudes, _ = read(tmp_path, mixed + late[70:])
    assert len(attitudes) == COUNT


@pytest.mark.parametrize(
    "begins_s", [[90_000.0], [90_000.0, 40_000.0], [90_000.0, 90_000.5], [0.0]]
)
def test_stamps_of_another_time_cost_themselves_alone(tmp_path, begins_s):
    """A clock that jumps for a packet or two, or a packet that somebody made."""
    rows = flight(5.0)
    rows[40:40] = [flight(each_s, count=1)[0] for each_s in begins_s]
    attitudes, heights = read(tmp_path, rows)
    assert [seen.t_s for seen in attitudes] == pytest.approx([5.0 + 0.1 * i for i in range(COUNT)])
    assert len(heights) == HEIGHTS


def test_a_flight_with_a_gap_of_a_minute_is_one(tmp_path, caplog):
    attitudes, _ = read(tmp_path, flight(5.0, count=60) + flight(70.0, count=40))
    assert len(attitudes) == COUNT
    assert not caplog.records


def test_rows_of_a_csv_whose_time_goes_back_are_told(tmp_path, caplog):
    path = tmp_path / "a.csv"
    path.write_text("t_s,height_m\n5,1\n6,2\n0,1\n7,2\n")
    assert len(load_telemetry(path).measurements(0.0)) == 3
    assert "1 measurements left out" in caplog.text


def test_what_holds_no_packet_is_no_tlog(tmp_path):
    with pytest.raises(SourceError, match="is not a tlog"):
        read(tmp_path, [bytes(5000)])


def test_one_byte_of_a_real_flight_costs_one_packet(data_folder, tmp_path, caplog):
    path = data_folder / "mavlink/arducopter-4.7dev_battery.tlog.gz"
    whole = bytearray(gzip.decompress(path.read_bytes()))
    count = len(read(tmp_path, [bytes(whole)])[0])
    assert not caplog.records
    at = whole.index(b"\xfd", len(whole) // 10)
    while whole[at + 7 : at + 10] != b"\x1e\0\0":  # an ATTITUDE
        at = whole.index(b"\xfd", at + 1)
    whole[at] = 0
    assert len(read(tmp_path, [bytes(whole)])[0]) == count - 1
