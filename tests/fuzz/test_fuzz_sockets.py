"""Every listening socket: on the loopback unless told otherwise, alive after rubbish, and none left out here."""

import re
import socket
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mavlink_strategies import stream
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from bench.hil.ports import StampedPort, is_loopback, parse_listen
from saranga.errors import UsageError
from saranga.transport import open_transport
from sitl.autopilot.servers import MAX_CLIENTS, TcpServer, UdpClient, UdpServer
from sitl.rig import VirtualRig
from sitl.rig_ports import TcpPort

ROOT = Path(__file__).resolve().parents[2]
HEARTBEAT = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(
    mavlink.MAVLink(None, srcSystem=255, srcComponent=190))
LISTENERS = {
    # Where a socket is bound, and who looks at it.
    "bench/preflight/mavsdk_bridge.py": "here: every address in it",
    "bench/thrust_stand/drivers/rcbenchmark.py": "here: its default in the URL",
    "bench/view.py": "here: the viewer's --bind",
    "saranga/transport.py": "here: udpin binds to the host of its URL",
    "sitl/autopilot/arducopter.py": "here: every address in it",
    "sitl/autopilot/servers.py": "here",
    "sitl/rig_ports.py": "here",
}


def test_no_listener_is_left_out() -> None:
    found = {str(path.relative_to(ROOT)) for package in ("saranga", "sitl", "bench")
             for path in (ROOT / package).rglob("*.py")
             if re.search(r"\.bind\(|create_server\(|\.listen\(", path.read_text(encoding="utf-8"))}
    assert found == set(LISTENERS), "a new listener: see to it that it binds to the loopback, and add it here"


@pytest.mark.parametrize("make", [
    lambda: TcpServer(port=0), lambda: UdpServer(port=0), lambda: UdpClient(), TcpPort,
    lambda: StampedPort(*parse_listen("--mavlink", "tcp://127.0.0.1:0"))],
    ids=["TcpServer", "UdpServer", "UdpClient", "TcpPort", "StampedPort"])
def test_a_listener_binds_to_the_loopback_by_default(make: Callable[[], Any]) -> None:
    with closing(make()) as port:
        inner = getattr(port, "_server", port)
        sock = inner if isinstance(inner, socket.socket) else getattr(inner, "_listener", None) or inner._sock
        assert sock.getsockname()[0] == "127.0.0.1"


def test_commands_that_listen_default_to_the_loopback() -> None:
    import inspect

    from bench.hil_cli import hil
    from bench.thrust_stand.drivers.rcbenchmark import build

    parameters = inspect.signature(hil).parameters
    for name in ("listen", "mavlink"):
        assert is_loopback(parse_listen(name, parameters[name].default)[0])
    assert inspect.signature(build).parameters["bind"].default == "127.0.0.1"
    viewer = (ROOT / "bench" / "view.py").read_text(encoding="utf-8")
    assert '"--bind", LOOPBACK' in viewer and 'LOOPBACK = "127.0.0.1"' in viewer
    for name in ("sitl/autopilot/arducopter.py", "bench/preflight/mavsdk_bridge.py"):
        hosts = re.findall(r'(?:bind|create_server)\(\((.*?),', (ROOT / name).read_text(encoding="utf-8"))
        assert hosts and set(hosts) <= {'"127.0.0.1"', "LOOPBACK"}, name


@pytest.mark.parametrize(("host", "own"), [("127.0.0.1", True), ("localhost", True), ("0.0.0.0", False),
                                           ("192.168.1.2", False)])
def test_an_address_that_is_open_to_others_is_told_apart(host: str, own: bool) -> None:
    assert is_loopback(host) is own


@pytest.mark.parametrize("url", ["tcp://127.0.0.1", "udp://127.0.0.1:1", "tcp://:7000", "7000", "tcp://h:99999",
                                 "tcp://h:1/x", "tcp://[::1"])
def test_a_bad_address_is_bad_usage(url: str) -> None:
    with pytest.raises(UsageError, match="--listen"):
        parse_listen("--listen", url)


def heard(port: Any, wanted: bytes) -> bool:
    """Whether `wanted` comes out of the port within some seconds."""
    data = b""
    for _ in range(1000):
        data += port.poll()
        if wanted in data:
            return True
        time.sleep(0.005)
    return False


@given(st.lists(st.one_of(stream(st.integers(0, 255)), st.binary(max_size=600)), max_size=6))
@settings(max_examples=25, deadline=None)
def test_tcp_survives_rubbish_and_serves_the_next_program(pieces: list[bytes]) -> None:
    with closing(TcpServer(port=0)) as server:
        address = "127.0.0.1", int(server.url.rpartition(":")[2])
        with socket.create_connection(address) as bad:
            for piece in pieces:
                bad.sendall(piece)
                server.poll()
            server.send(HEARTBEAT)
        with socket.create_connection(address) as good:
            good.sendall(HEARTBEAT)
            assert heard(server, HEARTBEAT)


@given(st.lists(st.binary(max_size=600), max_size=6))
@settings(max_examples=25, deadline=None)
def test_udp_survives_rubbish_and_keeps_programs_apart(pieces: list[bytes]) -> None:
    with closing(UdpServer(port=0)) as server, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as bad, \
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as good:
        address = "127.0.0.1", int(server.url.rpartition(":")[2])
        for piece in pieces:
            bad.sendto(piece, address)
        server.poll()
        good.sendto(HEARTBEAT, address)
        assert heard(server, HEARTBEAT), "what another program began must not swallow it"
        server.send(HEARTBEAT)


def test_more_programs_than_there_is_room_for_do_not_hurt() -> None:
    with closing(TcpServer(port=0)) as server:
        address = "127.0.0.1", int(server.url.rpartition(":")[2])
        crowd = []
        for _ in range(MAX_CLIENTS + 8):  # a few more than are served: they wait in the system's queue
            crowd.append(socket.create_connection(address))
            crowd[-1].sendall(b"\xfd" * 50)
            server.poll()
        for _ in range(20):
            server.poll()
        assert server.clients <= MAX_CLIENTS
        for sock in crowd:
            sock.close()
        with socket.create_connection(address) as good:
            good.sendall(HEARTBEAT)
            assert heard(server, HEARTBEAT)


@given(st.lists(st.binary(max_size=5000), max_size=4))
@settings(max_examples=25, deadline=None)
def test_the_rig_port_and_the_rig_survive_rubbish(virtual_rig: VirtualRig, pieces: list[bytes]) -> None:
    with closing(TcpPort()) as port:
        with socket.create_connection(("127.0.0.1", int(port.url.rpartition(":")[2]))) as bad:
            for piece in pieces:
                bad.sendall(piece)
                port.write(virtual_rig.receive(port.read()))
        for _ in range(3):
            port.read()
        assert virtual_rig.receive(b"".join(pieces)) is not None


@pytest.fixture(scope="module")
def virtual_rig() -> VirtualRig:
    from saranga.echo import load_sonar
    from sitl.acoustics.shield import load_shielding
    from sitl.acoustics.sonar import AcousticModel
    from sitl.scene import build_scene, load_scene

    scene, geometry = build_scene(load_scene("open"), 1), load_sonar("pair")
    return VirtualRig(AcousticModel(scene.primitives, scene.weather, geometry, load_shielding("none"), 1), geometry)


def test_the_udp_link_of_the_companion_hears_one_program_only() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    link = open_transport(f"udpin://127.0.0.1:{port}")
    with closing(link), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as first, \
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as second:
        first.sendto(b"first", ("127.0.0.1", port))
        assert link.read(5.0) == b"first"
        second.sendto(b"second", ("127.0.0.1", port))
        first.sendto(b"again", ("127.0.0.1", port))
        assert link.read(5.0) in (b"again", b"") and b"second" not in link.read(0.1)
