"""What a watchdog leaves to the spare one: the newest whole word, whatever it was doing."""

import mmap
import os

import pytest
from hypothesis import given
from hypothesis import strategies as st
from link_peer import free_port

from vwnav.watchdog.process import WatchdogOptions, WatchdogPorts
from vwnav.watchdog.spare import LastWord

WORDS = st.lists(st.binary(max_size=300), max_size=6)


def read_elsewhere(word: LastWord) -> tuple[int, bytes]:
    """As by another process, which has the memory alone."""
    other = LastWord(os.dup(word.descriptor))
    read = other.read()
    other.close()
    return read


@given(WORDS)
def test_the_newest_word_is_read(words):
    word = LastWord()
    for number, data in enumerate(words, 1):
        word.write(data)
        assert read_elsewhere(word) == (number, data)
    assert read_elsewhere(word) == (len(words), words[-1] if words else b"")
    word.close()


@given(st.binary(min_size=1, max_size=300), st.binary(min_size=1, max_size=300), st.data())
def test_of_one_that_was_killed_while_it_wrote_the_word_before_is_read(before, torn, data):
    word = LastWord()
    word.write(before)
    word.write(torn)
    with mmap.mmap(word.descriptor, 0) as pages:
        at = pages.find(torn)  # the second word lies on the first page, its head before it
        spoilt = at + data.draw(st.integers(0, len(torn) - 1))
        pages[spoilt] ^= 0xFF
    found = read_elsewhere(word)
    word.close()
    assert found == (1, before)


def test_what_does_not_fit_is_said_and_spoils_nothing():
    word = LastWord()
    word.write(b"whole")
    with pytest.raises(ValueError, match="do not fit"):
        word.write(bytes(1 << 16))
    assert read_elsewhere(word) == (1, b"whole")
    word.close()


@pytest.mark.parametrize("word", [b"garbage", b"\x80\x04N.", b"\x80\x05]"])
def test_a_word_that_cannot_be_read_keeps_no_spare_one_from_guarding(word):
    """It knows nothing then, and hears of the navigator in the next beat."""
    url = f"udpin://127.0.0.1:{free_port()}"
    ports = WatchdogPorts(WatchdogOptions(connection=url, took_over=word, starts_left=0))
    assert ports.ports["keepalive_port"] > 0
    ports.close()
