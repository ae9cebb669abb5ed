"""A live camera is watched while it comes and goes."""

import itertools

import numpy as np
import pytest

from vwnav.calibration import board_session
from vwnav.calibration.board_session import BoardSession
from vwnav.cameras.live import RealTimeSource
from vwnav.errors import SourceError

PLAIN = np.full((48, 64), 90, np.uint8)


class Camera:
    """Gives images of these widths, then its cable is off; it is never there again."""

    opened = 0

    def __init__(self, widths) -> None:
        self._images = iter([np.full((48, width), 90, np.uint8) for width in widths])
        Camera.opened += 1
        if Camera.opened > 1:
            raise SourceError("cannot open the camera")

    def grab(self):
        image = next(self._images, None)
        return None if image is None else (0.0, image)

    def close(self) -> None: ...


@pytest.fixture
def session(monkeypatch):
    """Of a camera with images of these widths; a person presses Ctrl-C at the second wait."""
    waits, sources = itertools.count(), []
    Camera.opened = 0

    def sleep(_) -> None:
        if next(waits):
            raise KeyboardInterrupt

    monkeypatch.setattr(board_session.time, "sleep", sleep)

    def begin(*widths) -> BoardSession:
        sources.append(RealTimeSource(lambda: Camera(widths), timeout_s=1.0))
        return BoardSession(sources[-1])

    yield begin
    for source in sources:
        source.close()


def test_who_does_not_wait_for_the_cable_gets_what_was_seen_before(session, capsys):
    watched = session(64)
    watched.watch()
    assert (watched.seen, watched.size_wh) == (1, (64, 48))
    said = capsys.readouterr().err
    assert said.count("views are kept: waiting for it, Ctrl-C takes what there is") == 1
    assert "no pictures any more" in said


def test_a_camera_that_never_gave_an_image_is_not_waited_for(session):
    with pytest.raises(SourceError, match="no pictures any more"):
        session().watch()


def test_a_camera_that_comes_back_in_another_size_is_waited_for(session, capsys, monkeypatch):
    watched = session(64)
    frames = iter([(64, 0), (32, 1), (32, 2), (64, 3)])

    def next_frame():
        width, index = next(frames, (0, 0))
        if not width:
            raise KeyboardInterrupt
        return board_session.Frame(0.1 * index, np.full((48, width), 90, np.uint8), index)

    monkeypatch.setattr(watched._images, "next_frame", next_frame)
    watched.watch()
    assert (watched.seen, watched.size_wh) == (4, (64, 48))
    assert capsys.readouterr().err.count("is 32 x 48 px, what came before it 64 x 48") == 1
