"""What `vwnav replay flight.mcap` does: the filter again, on what it was told in flight."""

import time
from collections import OrderedDict
from dataclasses import fields
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from vwnav.assemble import ground_of
from vwnav.config import Config, explain
from vwnav.errors import MapError, SourceError
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.ekf import Ekf
from vwnav.estimation.inputs import Asked, Input
from vwnav.maps.pack import MapPack
from vwnav.offline.report import ReplayOptions, ReplayRecord, no_halves
from vwnav.recording.input_log import About, ImageSeen, read_about, read_input_log
from vwnav.recording.reader import is_cut_off
from vwnav.recording.run_folder import check_run_folder, make_run_folder
from vwnav.screen import LiveLine, say
from vwnav.seams import StepResult
from vwnav.types import Estimate, Rejected, RejectReason

_ESTIMATES_KEPT = 1000  # between an image's estimate and its mark other threads ask for a few

Row = tuple[StepResult, float | None]  # with the commanded yaw, radians


def replay_inputs(options: ReplayOptions) -> None:
    """Play a recording's input log and write the run folder.

    Raises:
        VwnavError: nothing of it can be replayed, or the map is another than in flight.
        OSError: there is no room for what it writes.
    """
    path = Path(options.source)
    check_run_folder(options.output)
    about, config = read_about(path)
    ekf_config = _ekf_config(config, about)
    with MapPack.open(options.map_path) as pack:
        _check_ground(pack, about)
        ground = ground_of(pack, about.local_frame) if about.ground_id else None
        player = Player(Ekf(ekf_config, ground))
        trouble = player.play(path)
        if not player.rows:
            raise trouble or SourceError(f"{path} broke off before the first picture")
        if is_cut_off(path):
            say(f"{path} breaks off, as after a crash or on a full disk: replaying what is there")
        if player.broken is not None:
            say(f"the filter broke on an input, as it must have in flight: {player.broken!r}")
        folder = make_run_folder(options.output, "replay")
        with no_halves(folder):
            record = ReplayRecord(folder, about, pack, player.rows[0][0].t_s)
            record.tally.busy_s = player.busy_s
            for row in player.rows:
                record.add(*row)
            record.close()
    identical, line = compare(path.parent / "trajectory.csv", folder / "trajectory.csv")
    record.summarise(options, {"identical": identical})
    if line:
        say(line)
    if trouble is not None:
        raise SourceError(f"{trouble}; the {len(player.rows)} pictures before it are in {folder}")


class Player:
    """Plays an input log into a filter and collects what `trajectory.csv` is made of.

    Attributes:
        rows: one for each image.
        busy_s: time it took.
        broken: the first thing that the filter raised.
    """

    def __init__(self, ekf: Ekf) -> None:
        self.rows: list[Row] = []
        self.busy_s = 0.0
        self.broken: Exception | None = None
        self._ekf = ekf
        self._estimates: OrderedDict[float, Estimate] = OrderedDict()

    def play(self, path: Path) -> SourceError | None:
        """Play as far as it goes; what ended it before its end, if anything did."""
        start_s = time.perf_counter()
        try:
            with LiveLine() as line:
                for seen in read_input_log(path):
                    if not isinstance(seen, ImageSeen):
                        self._take(seen)
                        continue
                    self._image(seen)
                    line.show(seen.t_s, f"{seen.t_s - self.rows[0][0].t_s:6.1f} s replayed")
        except SourceError as error:
            return error
        finally:
            self.busy_s = time.perf_counter() - start_s
        return None

    def _take(self, seen: Input) -> None:
        try:
            estimate = self._ekf.take(seen)
        except Exception as error:  # whatever it was, the flight went on after it
            self.broken = self.broken or error
            return
        if estimate is None or not isinstance(seen, Asked):
            return
        self._estimates[seen.t_s] = estimate
        self._estimates.move_to_end(seen.t_s)
        if len(self._estimates) > _ESTIMATES_KEPT:
            self._estimates.popitem(last=False)

    def _image(self, seen: ImageSeen) -> None:
        motion = Rejected(seen.t_s, RejectReason.NOT_TRIED, "odometry is on the tape")
        estimate = self._estimates.get(seen.t_s)
        self.rows.append(
            (StepResult(seen.t_s, motion, seen.outcome, estimate), seen.commanded_yaw_rad)
        )


def compare(flown: Path, replayed: Path) -> tuple[bool | None, str]:
    """Whether two trajectories are the same to the byte, and a line that says so.

    Of a flight that crashed the rows it had written are taken; None and nothing where none are.
    """
    if not flown.exists():
        flown = flown.with_suffix(".csv.part")
    if not flown.exists():
        return None, ""
    first, second = (path.read_bytes().splitlines(keepends=True) for path in (flown, replayed))
    count = f"{len(second) - 1} rows"
    if first == second:
        return True, f"identical to {flown}: {count}, byte for byte"
    differing = (i for i, (a, b) in enumerate(zip(first, second, strict=False)) if a != b)
    row = next(differing, min(len(first), len(second)))
    if row == len(second):
        return (
            True,
            f"identical to {flown} as far as the recording goes: {count} of {len(first) - 1}",
        )
    t_s = second[row].split(b",")[0].decode()
    return False, f"NOT identical to {flown}: differs from t_s {t_s} on, row {row} of {count}"


def _ekf_config(config: Any, about: About) -> EkfConfig:
    """The filter's settings in flight; those that are newer than it have their defaults.

    Raises:
        SourceError: they are not of this version's filter.
    """
    recorded = config.get("ekf") if isinstance(config, dict) else None
    if not isinstance(recorded, dict):
        raise SourceError("the recording holds no settings of the filter")
    known = {field.name for field in fields(EkfConfig)}
    if unlike := sorted(set(recorded) - known):
        raise SourceError(
            f"the filter of vwnav {about.version}, which recorded this, has other settings "
            f"({', '.join(unlike)}): replay it with that version"
        )
    if newer := sorted(known - set(recorded)):
        say(f"recorded by vwnav {about.version}, whose filter lacked {', '.join(newer)}: defaults")
    try:
        return Config(ekf=recorded).ekf  # type: ignore[arg-type]
    except ValidationError as error:
        raise SourceError(f"the recorded settings of the filter: {explain(error)}") from error


def _check_ground(pack: MapPack, about: About) -> None:
    """Without terrain heights in the filter any map will do: it is only drawn under the track."""
    if about.ground_id is None:
        return
    if pack.heights is None or pack.heights.identity != about.ground_id:
        raise MapError(
            f"{pack.path} is another map: its terrain heights are not those that the filter used "
            "in flight; give the pack of that flight"
        )
