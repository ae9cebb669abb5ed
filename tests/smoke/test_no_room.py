"""A disk that is full, or standard output that takes nothing: one line, and no half of a file."""

import os
import subprocess
import sys

import pytest
from smoke_place import ROOT, Run

LIMITED = """
import resource, sys
most_bytes = int(sys.argv.pop(1))
resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, most_bytes))
from vwnav.__main__ import main
main()
"""


def limited(most_bytes, *arguments):
    """The command where no file may be larger."""
    command = [sys.executable, "-c", LIMITED, str(most_bytes), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    return Run(done.returncode, done.stdout, done.stderr)


@pytest.fixture(scope="module")
def replayed(vwnav, place, tmp_path_factory):
    """A whole replay's folder."""
    out = tmp_path_factory.mktemp("replayed") / "out"
    words = ("--map", place.pack, "--camera", place.camera, "--features", "sift", "-o", out)
    assert vwnav("replay", place.video, *words).code == 0
    return out


@pytest.mark.parametrize("name", ["config.toml", "trajectory.csv", "track.png"])
def test_a_replay_without_room_names_the_file_and_leaves_no_half(replayed, place, tmp_path, name):
    """One byte too few for that file; those that are smaller are written before it."""
    most_bytes = (replayed / name).stat().st_size - 1
    source, extra = replayed / "flight.mcap", ("--features", "learned")
    if name == "config.toml":
        source, extra = place.video, ("--camera", place.camera)
    out = tmp_path / "out"
    done = limited(most_bytes, "replay", source, "--map", place.pack, "-o", out, *extra)
    assert done.code == 1
    assert name in done.complaint
    assert "File too large" in done.complaint
    whole = ["trajectory.csv"] if name == "track.png" else []
    assert [each.name for each in out.iterdir()] == whole


def test_a_board_without_room_leaves_the_one_that_was_there(tmp_path):
    board = tmp_path / "board.pdf"
    printed = "vwnav calibration board, printed last week".encode("utf-16-be")
    board.write_bytes(printed)
    done = limited(1000, "calibrate", "board", "-o", board)
    assert done.code == 1
    assert "board.pdf: cannot write (File too large)" in done.complaint
    assert [each.name for each in tmp_path.iterdir()] == ["board.pdf"]
    assert board.read_bytes() == printed


@pytest.mark.parametrize(
    "words", [("--version",), ("--help",), ("map", "info"), ("map", "info", "--json"),
              ("localize", "--json")],
)  # fmt: skip
def test_standard_output_that_takes_nothing_is_one_line(place, words):
    extra = {"map": [place.pack], "localize": [place.image, "--map", place.pack, "--hfov-deg=70"]}
    command = [sys.executable, "-m", "vwnav", *words, *map(str, extra.get(words[0], []))]
    with open("/dev/full", "w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, cwd=ROOT)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1:] == ["vwnav: standard output: No space left on device"]
    assert "Traceback" not in done.stderr
    assert "Exception ignored" not in done.stderr


def test_what_is_left_to_be_printed_at_the_end_is_noticed_too():
    script = "import vwnav.__main__ as it; it.app = lambda: print('x'); it.main()"
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-c", script], stdout=full, stderr=subprocess.PIPE, text=True, cwd=ROOT
        )
    assert (done.returncode, done.stderr) == (
        1, "vwnav: standard output: No space left on device\n",
    )  # fmt: skip


def test_a_file_that_nobody_named_is_not_taken_for_standard_output():
    script = (
        "import vwnav.__main__ as it\n"
        "def fail(): raise OSError(28, 'No space left on device')\n"
        "it.app = fail; it.main()"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=ROOT)
    assert (done.returncode, done.stderr) == (1, "vwnav: a file: No space left on device\n")


def test_of_a_closed_pipe_nothing_is_said(place):
    reader, writer = os.pipe()
    os.close(reader)
    command = [sys.executable, "-m", "vwnav", "map", "info", str(place.pack)]
    done = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, text=True, cwd=ROOT)
    os.close(writer)
    assert (done.returncode, done.stderr) == (1, "")


def test_an_error_that_names_no_file_keeps_its_traceback():
    script = (
        "import vwnav.__main__ as it\n"
        "def fail(): raise ConnectionRefusedError(111, 'refused')\n"
        "it.app = fail; it.main()"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=ROOT)
    assert "Traceback" in done.stderr
