"""The power is cut at any moment: what was recorded until a second before is readable.

The disk is a model around the real recorder and the real files: a file holds what was last synced
and a random part of the pages after that; a folder holds the names that were last synced. Time is
stepped, and each sync takes up to a quarter of a second of it.
"""

import csv
import os
import stat
import threading
import time
from itertools import takewhile
from pathlib import Path

import numpy as np
import pytest

from vwnav.geometry.geodesy import LocalFrame
from vwnav.recording.disk import thread
from vwnav.recording.reader import is_cut_off, read_metadata, read_recording
from vwnav.recording.recorder import Recorder
from vwnav.recording.run_folder import TrajectoryWriter, make_run_folder, write_json
from vwnav.seams import StepResult
from vwnav.types import Frame, Rejected, RejectReason

PAGE_BYTES = 4096
TICK_S = 0.02
FLIGHT_S = 12.0
READABLE_UNTIL_S = 1.0  # before the cut
SLOWEST_SYNC_S = 0.25
MOMENTS = 50


class Disk:
    """What of the files below a folder has reached the disk, and when."""

    def __init__(self, root: Path) -> None:
        self.now_s = 0.0
        self._root = root
        self._rng = np.random.default_rng(6)
        self._fsync = os.fsync
        self._lock = threading.Lock()
        self._files: dict[int, list[tuple[float, int]]] = {}  # inode: (when, bytes)
        self._names: dict[int, list[tuple[float, dict[str, int]]]] = {}  # inode: (when, inodes)
        self._names[root.stat().st_ino] = [(0.0, inodes(root))]

    def fsync(self, handle: int) -> None:
        """Stands in for `os.fsync`: there when it is done, which takes a while."""
        seen = os.fstat(handle)
        with self._lock:
            done_s = self.now_s + float(self._rng.uniform(0.01, SLOWEST_SYNC_S))
            if stat.S_ISDIR(seen.st_mode):
                folder = Path(os.readlink(f"/proc/self/fd/{handle}"))
                self._names.setdefault(seen.st_ino, []).append((done_s, inodes(folder)))
            else:
                self._files.setdefault(seen.st_ino, []).append((done_s, seen.st_size))
        self._fsync(handle)

    def snapshot(self) -> dict[int, bytes]:
        """What the files hold now, in memory."""
        return {p.stat().st_ino: p.read_bytes() for p in self._root.rglob("*") if p.is_file()}

    def cut(self, t_s: float, content: dict[int, bytes], out: Path) -> Path:
        """Write what is there when the power comes back, as a copy of the root folder."""
        with self._lock:
            self._restore(self._root.stat().st_ino, t_s, content, out)
        return out

    def _restore(self, inode: int, t_s: float, content: dict[int, bytes], out: Path) -> None:
        out.mkdir()
        for name, each in latest(self._names.get(inode, []), t_s, {}).items():
            if each in content:
                synced = latest(self._files.get(each, []), t_s, 0)
                (out / name).write_bytes(self._torn(content[each], synced))
            else:
                self._restore(each, t_s, content, out / name)

    def _torn(self, content: bytes, synced: int) -> bytes:
        left = bytearray(content[:synced])
        for start in range(synced // PAGE_BYTES * PAGE_BYTES, len(content), PAGE_BYTES):
            if self._rng.random() < 0.5:
                first, end = max(start, synced), min(start + PAGE_BYTES, len(content))
                left.extend(bytes(first - len(left)))  # pages that are lost are zeros
                left.extend(content[first:end])
        return bytes(left)


def inodes(folder: Path) -> dict[str, int]:
    return {each.name: each.stat().st_ino for each in folder.iterdir()}


def latest(happened, t_s: float, default):
    return next((what for when, what in reversed(happened) if when <= t_s), default)


def step(t_s: float) -> StepResult:
    nothing = Rejected(t_s, RejectReason.NOT_TRIED)
    return StepResult(t_s, nothing, nothing, None)


def settle(recorder: Recorder, t_s: float) -> None:
    """Wait until the thread that writes has done, and synced, all that came before."""
    for _ in range(2):
        reached = threading.Event()
        recorder.sequence("/settled", t_s, lambda reached=reached: {"x": reached.set()})
        assert reached.wait(30.0)


def settle_rows(path: Path, rows: int) -> None:
    until_s = time.monotonic() + 30.0
    while path.read_bytes().count(b"\n") < rows + 1 and time.monotonic() < until_s:
        time.sleep(0.0002)


def rows_before_damage(path: Path) -> list[float]:
    with path.open(newline="") as file:
        whole = takewhile(lambda line: line.endswith("\n") and "\0" not in line, file)
        return [float(row["t_s"]) for row in csv.DictReader(whole)]


class Flown:
    """A flight whose power is cut at `moments`: each with what is left of its folder."""

    def __init__(self, root: Path, seconds: float, moments: np.ndarray, monkeypatch) -> None:
        (root / "live").mkdir(parents=True)
        self.model = Disk(root / "live")
        monkeypatch.setattr(os, "fsync", self.model.fsync)
        monkeypatch.setattr(thread, "monotonic", lambda: self.model.now_s)
        monkeypatch.setattr(thread, "_ROUND_S", 0.0002)
        self.folder = make_run_folder(root / "live" / "runs" / "fly", "fly")
        self.recorder = Recorder(self.folder / "flight.mcap", {"settings": 1}, 25.0)
        self.rows = TrajectoryWriter(
            self.folder / "trajectory.csv", LocalFrame(60.0, 22.0, 0.0), 0.0
        )
        self.root = root
        self.left: list[tuple[float, Path]] = []
        self._image = np.random.default_rng(5).integers(0, 255, (160, 240), np.uint8)
        ticks = set(np.unique(np.round(moments / TICK_S).astype(int)))
        for tick in range(round(seconds / TICK_S)):
            self._tick(tick)
            if tick in ticks:
                t_s = self.model.now_s
                cut = self.model.cut(t_s, self.model.snapshot(), root / f"cut{tick}")
                self.left.append((t_s, cut / "runs" / "fly"))

    def _tick(self, tick: int) -> None:
        t_s = self.model.now_s = tick * TICK_S
        self.recorder.event(t_s, "x" * 200)
        self.recorder.frame(Frame(t_s, self._image, tick))
        self.rows.write(step(t_s))
        settle(self.recorder, t_s)
        settle_rows(self.folder / "trajectory.csv.part", tick + 1)


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    moments = np.random.default_rng(5).uniform(1.2, FLIGHT_S, MOMENTS + 5)
    with pytest.MonkeyPatch.context() as monkeypatch:
        flight = Flown(tmp_path_factory.mktemp("power"), FLIGHT_S, moments, monkeypatch)
        yield flight
        flight.recorder.close()
        flight.rows.close()


def due(t_s: float) -> list[float]:
    """When something was recorded that has to be there after a cut at `t_s`."""
    return [k * TICK_S for k in range(int((t_s - READABLE_UNTIL_S) / TICK_S + 1e-6) + 1)]


def test_whenever_the_power_is_cut_all_until_a_second_before_is_readable(flown):
    assert len(flown.left) >= MOMENTS
    torn = 0
    for t_s, folder in flown.left:
        times_s = [r.t_s for r in read_recording(folder / "flight.mcap", frozenset({"/event"}))]
        wanted = due(t_s)
        assert times_s[: len(wanted)] == pytest.approx(wanted), t_s
        assert times_s == pytest.approx([k * TICK_S for k in range(len(times_s))]), t_s
        torn += b"\0" * PAGE_BYTES in (folder / "flight.mcap").read_bytes()
        assert is_cut_off(folder / "flight.mcap")
        assert read_metadata(folder / "flight.mcap")["config"] == {"settings": 1}
    assert torn > 5  # pages were lost before others that were kept


def test_whenever_the_power_is_cut_the_rows_until_a_second_before_are_there(flown):
    for t_s, folder in flown.left:
        wanted = due(t_s)
        rows = rows_before_damage(folder / "trajectory.csv.part")
        assert rows[: len(wanted)] == pytest.approx(wanted), t_s


def test_files_that_were_finished_are_whole_when_the_power_is_cut_then(tmp_path, monkeypatch):
    flight = Flown(tmp_path, 2.0, np.empty(0), monkeypatch)
    flight.rows.close()
    flight.recorder.close()
    write_json(flight.folder / "run.json", {"completed": True})
    now_s = flight.model.now_s + SLOWEST_SYNC_S
    left = flight.model.cut(now_s, flight.model.snapshot(), tmp_path / "cut") / "runs" / "fly"
    assert sorted(p.name for p in left.iterdir()) == ["flight.mcap", "run.json", "trajectory.csv"]
    for path in left.iterdir():
        assert path.read_bytes() == (flight.folder / path.name).read_bytes()
    assert not is_cut_off(left / "flight.mcap")


def test_what_lies_behind_lost_pages_is_not_handed_out(tmp_path):
    recorder = Recorder(tmp_path / "a.mcap", {})
    for i in range(3000):
        recorder.event(i / 100, str(np.random.default_rng(i).bytes(100)))
    recorder.close()
    whole = (tmp_path / "a.mcap").read_bytes()
    ends = record_ends(whole)
    torn = whole[: ends[len(ends) // 2]]
    torn += bytes(9 * PAGE_BYTES) + whole[ends[3 * len(ends) // 4] : ends[-2]]
    (tmp_path / "torn.mcap").write_bytes(torn)
    stamps = [r.t_s for r in read_recording(tmp_path / "torn.mcap")]
    assert 500 < len(stamps) < 2500
    assert stamps == pytest.approx(np.arange(len(stamps)) / 100)


def record_ends(mcap: bytes) -> list[int]:
    """Where the records of a data section end."""
    at, ends = 8, []
    while mcap[at] != 0x0F:  # the section's end
        at += 9 + int.from_bytes(mcap[at + 1 : at + 9], "little")
        ends.append(at)
    return ends


def test_what_was_said_before_a_silence_does_not_wait_for_the_next_word(tmp_path, monkeypatch):
    monkeypatch.setattr(thread, "monotonic", time.monotonic)  # others' time stands
    recorder = Recorder(tmp_path / "a.mcap", {})
    for i in range(20):
        recorder.event(i / 100, "x")
    until_s = time.monotonic() + 20.0
    while len(list(read_recording(tmp_path / "a.mcap"))) < 20:
        assert time.monotonic() < until_s
        time.sleep(0.1)
    recorder.close()


def test_a_disk_that_syncs_slowly_is_left_half_of_the_time(monkeypatch):
    now_s, syncs = [0.0], []
    monkeypatch.setattr(thread, "monotonic", lambda: now_s[0])

    def slow() -> None:
        syncs.append(now_s[0])
        now_s[0] += 2.0

    def wait() -> None:
        now_s[0] += 0.01

    written = thread.DiskThread("slow", slow, lambda error: None)
    for _ in range(1000):  # ten seconds of writing
        written.put(wait)
    assert written.close(lambda: None, 30.0)
    assert np.diff(syncs) == pytest.approx(4.0, abs=0.02)
    assert len(syncs) >= 4


def test_what_is_large_waits_for_no_round_and_the_end_for_none_either(monkeypatch):
    monkeypatch.setattr(thread, "_ROUND_S", 60.0)
    done, last = threading.Event(), []
    writes = thread.DiskThread("large", lambda: None, lambda error: None)
    writes.put(lambda: last.append("small"))
    writes.put(done.set, at_once=True)
    assert done.wait(20.0)
    assert last == ["small"]  # in order
    writes.put(lambda: last.append("later"))
    assert writes.close(lambda: last.append("end"), 20.0)
    assert last == ["small", "later", "end"]
