"""The TCP and UDP ends that carry MAVLink between an autopilot and other programs."""

import socket
import time
from collections.abc import Callable

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from saranga.errors import DeviceError, UsageError
from sitl.autopilot.servers import TcpServer, UdpClient, UdpServer

MAV = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)


def ping(number: int) -> bytes:
    return mavlink.MAVLink_ping_message(number, number, 0, 0).pack(MAV)


def soon(read: Callable[[], bytes], size: int) -> bytes:
    """Collect from a non-blocking read until `size` bytes came, at most 2 s."""
    out = b""
    deadline = time.monotonic() + 2.0
    while len(out) < size and time.monotonic() < deadline:
        out += read()
        time.sleep(0.002)
    return out


def address(url: str) -> tuple[str, int]:
    host, port = url.split("//")[1].split(":")
    return host, int(port)


def test_tcp_carries_both_ways_for_several_clients() -> None:
    server = TcpServer(port=0)
    clients = [socket.create_connection(address(server.url)) for _ in range(3)]
    try:
        for number, client in enumerate(clients, 1):
            client.sendall(ping(number))
        assert len(soon(server.poll, 3 * len(ping(1)))) == 3 * len(ping(1))
        assert server.clients == 3
        server.send(ping(9))
        for client in clients:
            client.settimeout(2.0)
            assert client.recv(1000) == ping(9)
        clients[0].close()
        deadline = time.monotonic() + 2.0
        while server.clients == 3 and time.monotonic() < deadline:
            server.poll()
        assert server.clients == 2
    finally:
        for client in clients:
            client.close()
        server.close()


def test_two_half_frames_of_two_programs_are_not_mixed() -> None:
    server = TcpServer(port=0)
    one, two = (socket.create_connection(address(server.url)) for _ in range(2))
    try:
        one.sendall(ping(1)[:10])
        two.sendall(ping(2)[:12])
        time.sleep(0.05)
        assert server.poll() == b""
        one.sendall(ping(1)[10:])
        two.sendall(ping(2)[12:])
        got = soon(server.poll, 2 * len(ping(1)))
        assert got in (ping(1) + ping(2), ping(2) + ping(1))
    finally:
        one.close()
        two.close()
        server.close()


def test_a_client_that_does_not_read_is_let_go_and_nothing_blocks() -> None:
    server = TcpServer(port=0)
    client = socket.create_connection(address(server.url))
    try:
        soon(lambda: server.poll() or b"", 0)
        while server.clients == 0:
            server.poll()
        began = time.monotonic()
        for _ in range(2000):
            server.send(bytes(4096))
            if server.clients == 0:
                break
        assert server.clients == 0 and server.dropped_bytes > 0
        assert time.monotonic() - began < 10.0
    finally:
        client.close()
        server.close()


def test_a_port_in_use_is_named_with_what_to_do() -> None:
    for kind in (TcpServer, UdpServer):
        first = kind(port=0)
        port = address(first.url)[1]
        with pytest.raises(DeviceError, match=rf"port {port} .*in use.*choose another port"):
            kind(port=port)
        first.close()
        kind(port=port).close()


def test_bad_ports_and_hosts_are_named() -> None:
    with pytest.raises(UsageError, match="port must be within"):
        TcpServer(port=70_000)
    with pytest.raises(UsageError, match="port must be within"):
        UdpClient(port=0)
    with pytest.raises(DeviceError, match=r"198\.51\.100\.7.*cannot be opened"):
        TcpServer(host="198.51.100.7", port=0)


def test_servers_listen_on_loopback_by_default() -> None:
    for server in (TcpServer(port=0), UdpServer(port=0)):
        assert address(server.url)[0] == "127.0.0.1"
        server.close()


def test_udp_server_answers_whoever_spoke() -> None:
    server, port = UdpServer(port=0), socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    port.settimeout(2.0)
    try:
        server.send(ping(0))
        assert server.dropped_bytes == len(ping(0)), "nobody there yet"
        port.sendto(b"rubbish" + ping(1), address(server.url))
        assert soon(server.poll, len(ping(1))) == ping(1)
        server.send(ping(2))
        assert port.recvfrom(1000)[0] == ping(2)
    finally:
        port.close()
        server.close()


def test_udp_client_sends_to_a_listener_and_survives_its_absence() -> None:
    listener = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    listener.bind(("127.0.0.1", 0))
    listener.settimeout(2.0)
    number = listener.getsockname()[1]
    client = UdpClient(port=number)
    try:
        client.send(ping(1))
        data, peer = listener.recvfrom(1000)
        assert data == ping(1)
        listener.sendto(ping(2), peer)
        assert soon(client.poll, len(ping(2))) == ping(2)
        listener.close()
        for _ in range(5):
            client.send(ping(3))
            assert client.poll() == b""
    finally:
        listener.close()
        client.close()
