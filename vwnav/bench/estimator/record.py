"""A flight's sensor streams as MCAP, and back: the same events give the same trajectory."""

import dataclasses
from pathlib import Path
from typing import Any

import foxglove
import numpy as np

from vwnav.bench.estimator.streams import MeasurementEvent, MeasurementStream, Table
from vwnav.bench.estimator.world import FilterWorld, TrueTrajectory
from vwnav.errors import SourceError
from vwnav.estimation.beginning.starts import Start
from vwnav.estimation.inputs import Asked, decode, encode
from vwnav.recording.reader import read_recording
from vwnav.recording.recorder import plain

_SENSORS, _TABLE = "/sensors", "/table"


def save_stream(stream: MeasurementStream, path: Path) -> None:
    """Write the events in order of arrival; the truth stays out of it."""
    context = foxglove.Context()
    with foxglove.open_mcap(path, context=context):
        schema = {"type": "object"}
        sensors = foxglove.Channel(_SENSORS, schema=schema, context=context)
        if stream.ground is not None:
            table = foxglove.Channel(_TABLE, schema=schema, context=context)
            table.log(plain(stream.ground), log_time=0)
        for event in stream.events:
            content = {"arrival_s": event.arrival_s, "seen": encode(event.seen)}
            sensors.log(content, log_time=round(event.arrival_s * 1e9))


def load_stream(path: Path, truth: TrueTrajectory) -> MeasurementStream:
    """Read a recording of `save_stream`.

    Args:
        path: the recording.
        truth: to hold the estimates against.

    Raises:
        SourceError: not such a recording.
    """
    events, table = [], None
    for record in read_recording(path, frozenset({_SENSORS, _TABLE})):
        if record.topic == _TABLE:
            table = _table(record.content)
        else:
            seen = decode(record.content["seen"])
            if isinstance(seen, Start | Asked):
                raise SourceError(f"{path} is no recording of sensor streams")
            events.append(MeasurementEvent(record.content["arrival_s"], seen))
    if not events:
        raise SourceError(f"{path} holds no sensor streams")
    return MeasurementStream(truth, events, np.zeros(0), table)


def _table(fields: dict[str, Any]) -> Table:
    known = {field.name for field in dataclasses.fields(FilterWorld)}
    world = FilterWorld(**{name: value for name, value in fields["world"].items() if name in known})
    a, b = fields["phases"]
    return Table(world, fields["offset_m"], (a, b))
