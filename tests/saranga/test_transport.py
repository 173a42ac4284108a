"""MAVLink transports by URL: they carry bytes, and say plainly when they cannot."""

import os
import socket
import time

import pytest

from saranga.byte_links import ByteLink
from saranga.errors import DeviceError, UsageError
from saranga.transport import open_transport


def read_until(transport: ByteLink, wanted: bytes) -> bytes:
    got, deadline = b"", time.monotonic() + 5
    while len(got) < len(wanted) and time.monotonic() < deadline:
        got += transport.read(0.0)
        time.sleep(0.005)
    return got


@pytest.mark.parametrize("url", ["tcp://host", "bluetooth://x:1", "tcp://:5760", "serial://", "udpin://h:99999",
                                 "serial:///dev/x?baud=fast", ""])
def test_a_url_that_is_not_understood_lists_the_forms(url: str) -> None:
    with pytest.raises(UsageError, match="use serial://"):
        open_transport(url)


def test_tcp_carries_bytes_both_ways_and_a_closed_peer_is_an_error() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        transport = open_transport(f"tcp://127.0.0.1:{server.getsockname()[1]}")
        peer, _ = server.accept()
        assert transport.read(0.0) == b""
        peer.sendall(b"hello")
        assert read_until(transport, b"hello") == b"hello"
        transport.write(b"back")
        assert peer.recv(10) == b"back"
        peer.close()
        with pytest.raises(DeviceError, match="has closed the connection"):
            read_until(transport, b"x")
        transport.close()


def test_tcp_with_nobody_there_names_the_url() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with pytest.raises(DeviceError, match=f"127.0.0.1:{port}.*cannot connect"):
        open_transport(f"tcp://127.0.0.1:{port}")


def test_udpin_answers_whoever_spoke_first_and_ignores_others() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    listening = open_transport(f"udpin://127.0.0.1:{port}")
    first = open_transport(f"udpout://127.0.0.1:{port}")
    second = open_transport(f"udpout://127.0.0.1:{port}")
    listening.write(b"nobody yet")
    first.write(b"one")
    assert read_until(listening, b"one") == b"one"
    second.write(b"two")
    listening.write(b"answer")
    assert read_until(first, b"answer") == b"answer"
    time.sleep(0.05)
    assert listening.read(0.0) == b"" and second.read(0.0) == b""
    with pytest.raises(DeviceError, match="cannot listen"):
        open_transport(f"udpin://127.0.0.1:{port}")
    for transport in (listening, first, second):
        transport.close()


def test_serial_works_on_a_pty_and_unplugging_is_an_error() -> None:
    ours, theirs = os.openpty()
    transport = open_transport(f"serial://{os.ttyname(theirs)}?baud=57600")
    transport.write(b"abc")
    assert os.read(ours, 10) == b"abc"
    os.write(ours, b"xyz")
    assert read_until(transport, b"xyz") == b"xyz"
    os.close(theirs)
    os.close(ours)
    with pytest.raises(DeviceError, match="unplugged"):
        for _ in range(10):
            transport.read(0.0)
            transport.write(b"x")
    transport.close()


def test_serial_that_is_not_there_names_the_url() -> None:
    with pytest.raises(DeviceError, match="/dev/no-such-port"):
        open_transport("serial:///dev/no-such-port")
