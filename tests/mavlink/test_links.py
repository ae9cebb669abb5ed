"""Connection URLs, and the ways they open."""

import os
import socket
import termios
import threading
import time
from pathlib import Path

import pytest
from link_peer import free_port, wait_for

from vwnav.errors import LinkError
from vwnav.mavlink import links
from vwnav.mavlink.links import LinkAddress, open_link, parse_link


@pytest.mark.parametrize(
    ("url", "address"),
    [
        ("udpin://0.0.0.0:14540", LinkAddress("udpin", "0.0.0.0", 14540)),
        ("udp://:14540", LinkAddress("udpin", "0.0.0.0", 14540)),
        ("udpout://10.0.0.2:14550", LinkAddress("udpout", "10.0.0.2", 14550)),
        ("tcpout://localhost:5760", LinkAddress("tcpout", "localhost", 5760)),
        ("serial:///dev/ttyAMA0:921600", LinkAddress("serial", "/dev/ttyAMA0", 921600)),
    ],
)
def test_urls_are_read_as_mavsdk_reads_them(url, address):
    assert parse_link(url) == address


@pytest.mark.parametrize(
    "url", ["", "udpin", "ftp://x:1", "udpout://:14550", "udpin://h:0", "serial:///dev/ttyAMA0"]
)
def test_what_is_no_url_is_refused_with_an_example(url):
    with pytest.raises(LinkError, match="serial:///dev/ttyAMA0:921600"):
        parse_link(url)


def test_a_missing_serial_port_says_what_to_check():
    with pytest.raises(LinkError, match="dialout"):
        open_link(parse_link("serial:///dev/no-such-port:57600"))


def test_a_serial_port_carries_bytes_both_ways():
    master, slave = os.openpty()
    link = open_link(parse_link(f"serial://{os.ttyname(slave)}:57600"))
    os.write(master, b"\xfd\n\r\x00up")
    assert wait_for(link.read) == b"\xfd\n\r\x00up"
    link.write(b"down")
    assert os.read(master, 10) == b"down"
    link.close()


def test_a_serial_port_that_has_nothing_to_say_stays_open():
    master, slave = os.openpty()
    link = open_link(parse_link(f"serial://{os.ttyname(slave)}:57600"))
    assert {link.read() for _ in range(100)} == {b""}
    assert link.fileno() >= 0
    os.write(master, b"late")
    assert wait_for(link.read) == b"late"
    link.close()


def plugged(name: Path) -> int:
    """The far end of an adapter that is called `name` from now on."""
    master, slave = os.openpty()
    name.unlink(missing_ok=True)
    name.symlink_to(os.ttyname(slave))
    return master


def test_a_serial_adapter_that_is_pulled_out_comes_back(tmp_path):
    far = plugged(tmp_path / "tty")
    link = open_link(parse_link(f"serial://{tmp_path}/tty:57600"))
    assert link.read() == b""
    os.close(far)
    assert link.read() == b""
    assert link.fileno() == -1
    link.write(b"to nobody")
    far = plugged(tmp_path / "tty")
    wait_for(lambda: link.read() == b"" and link.fileno() >= 0)
    link.write(b"down")
    assert os.read(far, 20) == b"down"
    os.write(far, b"up")
    assert wait_for(link.read) == b"up"
    link.close()


def test_a_serial_adapter_that_is_pulled_out_in_a_write_comes_back(tmp_path):
    far = plugged(tmp_path / "tty")
    link = open_link(parse_link(f"serial://{tmp_path}/tty:57600"))
    os.close(far)
    link.write(b"to nobody")
    assert link.fileno() == -1
    far = plugged(tmp_path / "tty")
    wait_for(lambda: link.read() == b"" and link.fileno() >= 0)
    link.close()


def test_a_serial_port_that_takes_nothing_is_not_waited_for_and_not_lost():
    _, slave = os.openpty()
    link = open_link(parse_link(f"serial://{os.ttyname(slave)}:57600"))
    start_s = time.monotonic()
    for _ in range(500):
        link.write(bytes(280))
        assert link.read() == b""
    assert time.monotonic() - start_s < 1.0
    assert link.fileno() >= 0
    while link.has_room():  # a busy system moves what was written on a moment later
        assert time.monotonic() - start_s < 10.0, "it never fills"
        link.write(bytes(280))
    link.close()


def test_a_serial_port_that_another_has_says_so():
    _, slave = os.openpty()
    url = f"serial://{os.ttyname(slave)}:57600"
    link = open_link(parse_link(url))
    with pytest.raises(LinkError, match="another program has it"):
        open_link(parse_link(url))
    link.close()
    open_link(parse_link(url)).close()


def test_a_serial_adapter_that_is_pulled_out_while_it_is_opened_says_so(monkeypatch):
    _, slave = os.openpty()

    def pulled_out(*_):
        raise termios.error(5, "Input/output error")

    monkeypatch.setattr(termios, "tcflush", pulled_out)
    with pytest.raises(LinkError, match="Input/output error; check the cable"):
        open_link(parse_link(f"serial://{os.ttyname(slave)}:57600"))


def test_a_tcp_link_that_breaks_comes_back():
    with socket.create_server(("127.0.0.1", 0)) as server:
        link = open_link(parse_link(f"tcpout://127.0.0.1:{server.getsockname()[1]}"))
        first, _ = server.accept()
        first.close()
        wait_for(lambda: link.read() == b"" and link._port is None)
        assert link.fileno() == -1
        wait_for(lambda: link.read() == b"" and link.fileno() >= 0)
        second, _ = server.accept()
        link.write(b"again")
        assert second.recv(10) == b"again"
        link.close()


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        ("udpin://0.0.0.0:14540", "udp://:14540", True),
        ("udpin://0.0.0.0:14540", "udpout://127.0.0.1:14540", False),
        ("tcpout://127.0.0.1:5760", "tcp://127.0.0.1:5760", True),
        ("tcpout://127.0.0.1:5760", "tcpout://127.0.0.1:5762", False),
        ("serial:///dev/ttyACM0:57600", "serial:///dev/ttyACM0:115200", True),
    ],
)
def test_one_port_has_one_owner(one, other, same):
    assert parse_link(one).is_same_port(parse_link(other)) is same


def test_udpin_answers_the_autopilot_though_another_speaks_too():
    port = free_port()
    link = open_link(parse_link(f"udpin://127.0.0.1:{port}"))
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as autopilot,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station,
    ):
        for peer in (autopilot, station):
            peer.settimeout(2.0)
            peer.sendto(b"hello", ("127.0.0.1", port))
            assert wait_for(link.read) == b"hello"
        link.write(b"answer")
        assert autopilot.recv(10) == station.recv(10) == b"answer"
    link.close()


def test_udpin_answers_whoever_spoke_last():
    port = free_port()
    link = open_link(parse_link(f"udpin://127.0.0.1:{port}"))
    link.write(b"to nobody")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        peer.sendto(b"hello", ("127.0.0.1", port))
        assert wait_for(link.read) == b"hello"
        link.write(b"answer")
        peer.settimeout(2.0)
        assert peer.recv(10) == b"answer"
    time.sleep(0.01)
    link.write(b"to a peer that is gone")
    assert link.read() == b""
    link.close()


def test_a_tcp_link_whose_far_end_takes_nothing_any_more_is_opened_anew():
    """It is gone without a word, or hangs: the system would try for a quarter of an hour."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        link = open_link(parse_link(f"tcpout://127.0.0.1:{server.getsockname()[1]}"))
        hangs, _ = server.accept()
        server.settimeout(0.0)

        def called_again() -> socket.socket | None:
            assert link.read() == b""
            link.write(bytes(280))
            try:
                return server.accept()[0]
            except BlockingIOError:
                return None

        again = wait_for(called_again, 10.0)
        wait_for(lambda: link.read() == b"" and link.fileno() >= 0)
        link.write(b"here")
        assert again.recv(1 << 16).endswith(b"here")
        hangs.close()
        link.close()


def test_a_link_is_opened_anew_though_there_was_no_thread_for_it_at_first(monkeypatch):
    """As where memory is short, or so many processes are allowed and no more."""

    def none_left(thread: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    with socket.create_server(("127.0.0.1", 0)) as server:
        link = open_link(parse_link(f"tcpout://127.0.0.1:{server.getsockname()[1]}"))
        with monkeypatch.context() as short:
            short.setattr(threading.Thread, "start", none_left)
            server.accept()[0].close()
            wait_for(lambda: link.read() == b"" and link.fileno() < 0)
        wait_for(lambda: link.read() == b"" and link.fileno() >= 0)
        link.close()


def test_a_link_that_is_closed_while_it_is_opened_anew_leaves_nothing_open(monkeypatch):
    opens, may_open, open_stream = threading.Event(), threading.Event(), links._open_stream
    with socket.create_server(("127.0.0.1", 0)) as server:
        link = open_link(parse_link(f"tcpout://127.0.0.1:{server.getsockname()[1]}"))

        def open_late(*arguments):
            opens.set()
            may_open.wait(20.0)
            return open_stream(*arguments)

        monkeypatch.setattr(links, "_open_stream", open_late)
        server.accept()[0].close()
        wait_for(lambda: link.read() == b"" and opens.is_set())
        link.close()
        may_open.set()
        again, _ = server.accept()
        again.settimeout(5.0)
        assert again.recv(1) == b""
