"""Who is started again while a watchdog has the link is told what that one does."""

import contextlib
import os
import signal
import socket
import threading
import time
from collections.abc import Iterator

import pytest
from link_peer import PX4_LAND, free_port, wait_for
from watchdog_flight import flight

from vwnav.errors import LinkError
from vwnav.mavlink.links import parse_link
from vwnav.onboard import rejoining
from vwnav.onboard.rejoining import wait_for_the_aircraft
from vwnav.onboard.service import ServiceManager
from vwnav.watchdog import visitors
from vwnav.watchdog.keepalive import GuardState
from vwnav.watchdog.visitors import Guarding, Reception, visit

LANDS = Guarding(GuardState.LANDING, True, True, True)


@pytest.fixture
def url():
    return f"udpin://127.0.0.1:{free_port()}"


def test_what_a_watchdog_says_arrives_as_it_was_said():
    assert Guarding.unpack(LANDS.pack()) == LANDS
    for data in (b"", b"[]", b'{"state": "FLYING"}', b"\xff"):
        with pytest.raises(LinkError, match="another version"):
            Guarding.unpack(data)


def test_where_nobody_has_the_link_there_is_nothing_to_wait_for(url):
    assert list(visit(url)) == []
    assert not wait_for_the_aircraft(url, ServiceManager({}))


@contextlib.contextmanager
def opened(reception: Reception) -> Iterator[None]:
    """Its watchdog goes round."""
    over = threading.Event()

    def serve() -> None:
        while not over.wait(0.01):
            reception.step(LANDS, time.monotonic())

    thread = threading.Thread(target=serve)
    thread.start()
    yield
    over.set()
    thread.join()


def test_a_visitor_hears_what_goes_on_until_the_watchdog_leaves(url):
    reception = Reception(parse_link(url))
    told = visit(url)
    with opened(reception):
        assert [next(told), next(told)] == [LANDS, LANDS]
    reception.close()
    assert list(told) == []


def test_a_watchdog_that_hangs_is_named(url, monkeypatch):
    monkeypatch.setattr(visitors, "_UNHEARD_S", 0.1)
    reception = Reception(parse_link(url))
    with pytest.raises(LinkError, match=f"process {os.getpid()}"):
        next(visit(url))
    reception.close()


def test_visitors_that_do_not_read_or_have_gone_hold_nobody_up(url):
    reception, visitors_ = Reception(parse_link(url)), []
    for _ in range(3):
        visitor = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        visitor.connect(f"\0vwnav watchdog of {parse_link(url).port_name}")
        visitors_.append(visitor)
    visitors_[0].close()
    for t_s in range(2000):
        reception.step(LANDS, 2.0 * t_s)
    assert visitors_[1].recv(4096)
    reception.close()


def test_a_link_has_one_watchdog(url):
    reception = Reception(parse_link(url))
    with pytest.raises(LinkError, match="another watchdog"):
        Reception(parse_link(url))
    reception.close()
    Reception(parse_link(url)).close()


def test_beside_a_navigator_that_lives_nobody_waits():
    with flight() as flying:
        assert not wait_for_the_aircraft(flying.url, ServiceManager({}))


def test_started_again_in_flight_it_waits_and_says_so_until_the_aircraft_is_disarmed(monkeypatch):
    said: list[str] = []
    monkeypatch.setattr(rejoining, "say", said.append)
    with flight() as flying:
        flying.signal(signal.SIGKILL)
        threading.Timer(6.0, lambda: setattr(flying.peer, "armed", False)).start()
        assert wait_for_the_aircraft(flying.url, ServiceManager({}))
        assert flying.peer.custom_mode == PX4_LAND
    assert "which lands it, and nobody gives at present estimates of its place" in said[-2]
    assert "this one commands nothing" in said[-2]
    assert said[-1] == "its watchdog has left: getting ready, and a person arms"
    Reception(parse_link(flying.url)).close()


@pytest.mark.long
def test_a_visitor_stays_when_the_watchdog_dies_and_the_spare_one_follows(monkeypatch):
    """Else it would want the link for itself, while the aircraft flies."""
    monkeypatch.setattr(rejoining, "say", lambda _: None)
    waited: list[bool] = []
    with flight() as flying:
        flying.wait_for_a_spare()
        flying.signal(signal.SIGKILL)
        manager = ServiceManager({})
        visitor = threading.Thread(
            target=lambda: waited.append(wait_for_the_aircraft(flying.url, manager))
        )
        visitor.start()
        time.sleep(2.0)
        os.kill(flying.watchdog, signal.SIGKILL)
        wait_for(lambda: flying.peer.custom_mode == PX4_LAND, 8.0)
        visitor.join(3.0)
        assert visitor.is_alive()
        flying.peer.armed = False
        visitor.join(10.0)
    assert waited == [True]
