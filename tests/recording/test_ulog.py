"""PX4's logs of other versions and other sensors than today's."""

import struct
from collections.abc import Sequence
from pathlib import Path

import pytest

from vwnav.errors import SourceError
from vwnav.recording.telemetry_files import load_telemetry
from vwnav.types import Attitude, Range

pytest.importorskip("pyulog")

ATTITUDE = "vehicle_attitude:uint64_t timestamp;float[4] q;"
DISTANCES = "float min_distance;float max_distance;float current_distance;"
SENSOR = f"distance_sensor:uint64_t timestamp;{DISTANCES}int8_t signal_quality;uint8_t orientation;"
OLD_SENSOR = f"distance_sensor:uint64_t timestamp;{DISTANCES}uint8_t orientation;"
ROWS = 50
FORWARD, DOWNWARD = 0, 25  # MAV_SENSOR_ROTATION


def message(kind: str, body: bytes) -> bytes:
    return struct.pack("<HB", len(body), ord(kind)) + body


def ulog(formats: Sequence[str], topics: Sequence[tuple[str, int]], rows: list[bytes]) -> bytes:
    """A log by https://docs.px4.io/main/en/dev_log/ulog_file_format.html.

    Args:
        formats: name and fields of each topic.
        topics: name and instance of each that is logged; its place is its number.
        rows: number of the topic and its fields, packed.
    """
    told = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0)
    told += b"".join(message("F", text.encode()) for text in formats)
    for number, (name, instance) in enumerate(topics):
        told += message("A", struct.pack("<BH", instance, number) + name.encode())
    return told + b"".join(message("D", row) for row in rows)


def ranges_of(path: Path, data: bytes) -> list[float]:
    path.write_bytes(data)
    told = load_telemetry(path).measurements(0.0)
    assert sum(isinstance(seen, Attitude) for seen in told) == ROWS
    return [seen.distance_m for seen in told if isinstance(seen, Range)]


def times_us() -> range:
    return range(1_000_000, 1_000_000 + ROWS * 100_000, 100_000)


def attitude(number: int, t_us: int) -> bytes:
    return struct.pack("<HQ4f", number, t_us, 1.0, 0.0, 0.0, 0.0)


def test_of_several_distance_sensors_the_downward_one_is_taken(tmp_path):
    rows = []
    for t_us in times_us():
        rows.append(attitude(0, t_us))
        rows.append(struct.pack("<HQ3fbB", 1, t_us, 0.2, 40.0, 10.0, 100, FORWARD))
        rows.append(struct.pack("<HQ3fbB", 2, t_us, 0.2, 40.0, 20.0, 100, DOWNWARD))
    topics = [("vehicle_attitude", 0), ("distance_sensor", 0), ("distance_sensor", 1)]
    data = ulog([ATTITUDE, SENSOR], topics, rows)
    assert ranges_of(tmp_path / "a.ulg", data) == [20.0] * ROWS


def test_a_first_attitude_of_another_time_dates_no_other(tmp_path):
    rows = [attitude(0, 10**12), *(attitude(0, t_us) for t_us in times_us())]
    (tmp_path / "a.ulg").write_bytes(ulog([ATTITUDE], [("vehicle_attitude", 0)], rows))
    told = load_telemetry(tmp_path / "a.ulg").measurements(0.0)
    assert [seen.t_s for seen in told] == pytest.approx([0.1 * i for i in range(ROWS)])


def test_a_sensor_that_says_nothing_of_its_signal_is_believed(tmp_path):
    rows = []
    for t_us in times_us():
        rows.append(attitude(0, t_us))
        rows.append(struct.pack("<HQ3fB", 1, t_us, 0.2, 40.0, 20.0, DOWNWARD))
    topics = [("vehicle_attitude", 0), ("distance_sensor", 0)]
    data = ulog([ATTITUDE, OLD_SENSOR], topics, rows)
    assert ranges_of(tmp_path / "a.ulg", data) == [20.0] * ROWS


def test_a_log_without_a_field_that_is_needed_is_one_clear_line(tmp_path):
    rows = [struct.pack("<HQf", 0, t_us, 1.0) for t_us in times_us()]
    data = ulog(["vehicle_attitude:uint64_t timestamp;float yaw;"], [("vehicle_attitude", 0)], rows)
    (tmp_path / "a.ulg").write_bytes(data)
    with pytest.raises(SourceError, match=r"no 'q\[0\]' in it"):
        load_telemetry(tmp_path / "a.ulg")


def test_a_damaged_part_is_said(tmp_path, caplog):
    rows = [attitude(0, t_us) for t_us in times_us()]
    whole = ulog([ATTITUDE], [("vehicle_attitude", 0)], rows)
    size = len(message("D", rows[0]))
    at = len(whole) - 20 * size
    damaged = whole[:at] + bytes(500) + whole[at:]
    (tmp_path / "a.ulg").write_bytes(damaged)
    load_telemetry(tmp_path / "a.ulg")
    assert "a part of it is damaged" in caplog.text


def test_a_head_that_tells_of_more_than_there_is_ends(tmp_path):
    """Flash that was erased and not written yet reads 0xFF: pyulog went round in it without end."""
    path = tmp_path / "log.ulg"
    path.write_bytes(ulog([ATTITUDE] * 1500, [], []) + b"\xff" * 4096)
    with pytest.raises(SourceError, match=r"log\.ulg is not a ULog, or it is damaged: a message"):
        load_telemetry(path)
