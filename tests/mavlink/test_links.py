"""Connection URLs, and the ways they open."""

import os
import socket
import time

import pytest
from link_peer import free_port, wait_for

from vwnav.errors import LinkError
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
