"""The virtual rig through the decoder that a host uses: frames, numbers, answers, faults, real ports."""

import socket
import time
from typing import Any

import numpy as np
import pytest

from saranga.echo import load_sonar
from saranga.errors import DeviceError
from saranga.sources import open_source
from saranga.wire import (
    FLAG_BOOT,
    Config,
    CycleAssembler,
    Decoder,
    Echo,
    Fault,
    Hello,
    HelloRequest,
    SelfTest,
    Start,
    Status,
    Stop,
    Throttle,
    encode,
)
from sitl.acoustics.atmosphere import StandardAir
from sitl.acoustics.shield import load_shield
from sitl.acoustics.sonar import AcousticModel
from sitl.primitives import Primitives, cylinder_row
from sitl.rig import RigFaults, VirtualRig
from sitl.rig_ports import PtyPort, TcpPort

POSE = (np.array([0.0, 0.0, -1.0]), np.array([1.0, 0, 0, 0]), np.array([1.0, 0, 0]), np.full(4, 1.13))
POLE = Primitives.of(cylinders=[cylinder_row(np.array([1.0, 0.1, 0]), np.array([1.0, 0.1, -2]), 0.03, 1.0)])
CYCLE_US = 25_600


def acoustic_model(sonar: str = "pair", seed: int = 1) -> AcousticModel:
    return AcousticModel(POLE, StandardAir(), load_sonar(sonar), load_shield("foam"), seed)


def rig(sonar: str = "pair", seed: int = 1, **faults: Any) -> VirtualRig:
    model = acoustic_model(sonar, seed)
    return VirtualRig(model, model.geometry, RigFaults(**faults))


def stream(r: VirtualRig, cycles: int, start: int = 0) -> list[bytes]:
    return [r.cycle(k, k * CYCLE_US, *POSE) for k in range(start, start + cycles)]


def test_frames_carry_what_the_sensors_heard() -> None:
    r = rig("triple")
    hello, *messages = Decoder().feed(r.hello() + b"".join(stream(r, 2)))
    assert isinstance(hello, Hello) and hello.flags == FLAG_BOOT
    assert [(s.role, s.transmits, s.fop_hz) for s in hello.sensors] == [
        ("left", True, 53_000), ("right", False, 53_000), ("down", False, 53_000)]
    heard = acoustic_model("triple").cycle(*POSE, CYCLE_US)
    assert [(m.sensor, m.sequence, m.trigger) for m in messages] == [
        (0, 0, 0), (1, 0, 0), (2, 0, 0), (0, 1, 1), (1, 1, 1), (2, 1, 1)]
    for message, role in zip(messages[3:], ("left", "right", "down"), strict=True):
        assert isinstance(message, Echo)
        assert (message.device_time_us, message.fop_hz, message.odr, message.mode) == (CYCLE_US, 53_000, 6, 0)
        assert np.array_equal(message.iq, heard[role])


def test_host_assembles_cycles_across_the_wrap_of_clock_and_counters() -> None:
    r = rig()
    decoder, assembler = Decoder(), CycleAssembler()
    first = 2**32 // CYCLE_US - 2
    data = r.hello() + b"".join(r.cycle(2**32 - 3 + k, (first + k) * CYCLE_US, *POSE) for k in range(6))
    cycles = [c for m in decoder.feed(data) if (c := assembler.add(m)) is not None]
    assert [c.trigger for c in cycles] == [2**32 - 3, 2**32 - 2, 2**32 - 1, 0, 1, 2]
    assert np.diff([c.t_us for c in cycles]).tolist() == [CYCLE_US] * 5
    assert decoder.counters.sequence_gaps == 0


def test_status_comes_once_a_second() -> None:
    r = rig()
    found = [m for m in Decoder().feed(b"".join(stream(r, 160))) if isinstance(m, Status)]
    # 160 cycles last 4.07 s.
    assert [m.device_time_us // 1_000_000 for m in found] == [1, 2, 3, 4]
    assert found[-1].temperature_c == 20.0 and found[-1].state == 1
    assert found[0].cycles == 41


def test_answers_to_the_host() -> None:
    r = rig()
    decoder = Decoder()
    assert not r.running
    (hello,) = decoder.feed(r.receive(encode(HelloRequest())))
    assert isinstance(hello, Hello) and hello.sensors[0].self_test == "untested"
    assert r.receive(encode(Start(mode=1, rate_hz=20.0))) == b""
    assert r.running and r.rate_hz == pytest.approx(20.0)
    quiet = decoder.feed(r.cycle(0, 0, *POSE))
    assert all(isinstance(m, Echo) and m.mode == 1 for m in quiet)
    r.receive(encode(Stop()))
    assert not r.running and r.cycle(1, CYCLE_US, *POSE) == b""
    r.receive(encode(Start()))
    assert len(decoder.feed(r.cycle(2, 2 * CYCLE_US, *POSE))) == 2
    (tested,) = decoder.feed(r.receive(encode(SelfTest())))
    assert isinstance(tested, Hello) and [s.self_test for s in tested.sensors] == ["pass", "pass"]
    assert decoder.counters.sequence_gaps == 0


def test_configuration_changes_the_records_and_bad_ones_are_refused() -> None:
    r = rig()
    assert r.receive(encode(Config(odr=4, samples=64))) == b""
    echo = Decoder().feed(r.cycle(0, 0, *POSE))[0]
    assert isinstance(echo, Echo) and echo.odr == 4 and echo.iq.shape == (64, 2)
    for message in (Config(sensor=0, odr=4, samples=64), Throttle(value=0.1, token=1, deadline_ms=100)):
        (fault,) = Decoder().feed(r.receive(encode(message)))
        assert isinstance(fault, Fault) and type(message).__name__.upper() in fault.text.upper()


def test_link_test_sends_the_known_sequence() -> None:
    r = rig()
    (echo,) = Decoder().feed(r.receive(encode(SelfTest(sensor=1, kind=1))))
    assert isinstance(echo, Echo) and echo.sensor == 1
    assert echo.iq[:, 0].tolist() == list(range(256)) and echo.iq[:, 1].tolist() == [-n for n in range(256)]


def test_rubbish_from_the_host_is_counted_and_not_answered() -> None:
    r = rig()
    assert r.receive(b"\x05garbage\x00\xff\xff\x00") == b""
    status = [m for m in Decoder().feed(b"".join(stream(r, 45))) if isinstance(m, Status)]
    assert status[0].host_errors == 2


# ---- faults --------------------------------------------------------------------------------------
def test_silence() -> None:
    r = rig(silent_after_us=3 * CYCLE_US)
    assert [bool(data) for data in stream(r, 6)] == [True, True, True, False, False, False]
    assert r.receive(encode(HelloRequest()), 4 * CYCLE_US) == b""


@pytest.mark.parametrize(("after_us", "frames"), [(None, 0), (2 * CYCLE_US, 2)])
def test_dead_sensor(after_us: int | None, frames: int) -> None:
    r = rig(dead_role="right", dead_after_us=after_us)
    echoes = [m for m in Decoder().feed(b"".join(stream(r, 5))) if isinstance(m, Echo)]
    assert sum(m.sensor == 0 for m in echoes) == 5
    assert sum(m.sensor == 1 for m in echoes) == frames


def test_corrupt_frames_are_all_caught_and_the_same_ones_every_time() -> None:
    r = rig(corrupt_probability=0.2)
    decoder = Decoder()
    data = b"".join(stream(r, 150))
    got = len(decoder.feed(data))
    sent = 300 + 3
    assert 0.1 * sent < sent - got < 0.3 * sent
    counters = decoder.counters
    # A zero made within a frame splits it, one changed joins two: a bad frame may count once or twice.
    assert 0.5 * (sent - got) <= counters.bad_crc + counters.bad_cobs + counters.bad_message <= 2 * (sent - got)
    assert data == b"".join(stream(rig(corrupt_probability=0.2), 150))
    assert data != b"".join(stream(rig(seed=2, corrupt_probability=0.2), 150))


def test_dropped_frames_show_as_gaps() -> None:
    decoder = Decoder()
    got = len(decoder.feed(b"".join(stream(rig(drop_probability=0.25), 200))))
    sent = 400 + 5
    assert 0.15 * sent < sent - got < 0.35 * sent
    # All but those lost at the end, after which nothing came.
    assert sent - got - 6 <= decoder.counters.sequence_gaps <= sent - got


def test_delayed_frames_come_with_a_later_cycle_unchanged() -> None:
    late = stream(rig(delay_us=60_000), 8)
    prompt = stream(rig(), 8)
    assert late[:3] == [b"", b"", b""]
    assert late[3:] == prompt[:5]


# ---- ports ---------------------------------------------------------------------------------------
def wait_for(condition: Any, seconds: float = 5.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "did not happen in time"
        time.sleep(0.002)


def carry(port: Any, read: Any, frames: list[bytes]) -> bytes:
    """Write the frames and read the other end until as much has come."""
    got = b""
    for frame in frames:
        port.write(frame)
        got += read()
    end = time.monotonic() + 5.0
    total = sum(map(len, frames))
    while len(got) < total and time.monotonic() < end:
        port.read()
        got += read()
    return got


def test_pty_carries_the_same_bytes() -> None:
    import os

    frames = stream(rig(), 40)
    port = PtyPort()
    try:
        port.write(b"nobody hears this\0")
        assert port.dropped_bytes == 18 and not port.listening
        reader = os.open(port.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        wait_for(lambda: port.listening)

        def read() -> bytes:
            try:
                return os.read(reader, 65_536)
            except BlockingIOError:
                return b""

        assert carry(port, read, frames) == b"".join(frames)
        os.write(reader, bytes(range(256)))
        back = b""
        end = time.monotonic() + 5
        while len(back) < 256 and time.monotonic() < end:
            back += port.read()
        # Raw: no byte is a control character.
        assert back == bytes(range(256))
        os.close(reader)
        wait_for(lambda: not port.listening)
        assert port.dropped_bytes == 18
        port.write(b"gone\0")
        assert port.dropped_bytes == 23
        assert port.read() == b""
    finally:
        port.close()
        port.close()


def test_tcp_carries_the_same_bytes_and_takes_the_next_client() -> None:
    frames = stream(rig(), 40)
    port = TcpPort()
    try:
        assert port.url.startswith("tcp://127.0.0.1:")
        port.write(b"nobody\0")
        assert port.dropped_bytes == 7
        address = ("127.0.0.1", int(port.url.rsplit(":", 1)[1]))
        for _ in range(2):
            with socket.create_connection(address) as client:
                client.settimeout(0.01)
                wait_for(lambda: port.listening)

                def read(client: socket.socket = client) -> bytes:
                    try:
                        return client.recv(65_536)
                    except TimeoutError:
                        return b""

                assert carry(port, read, frames) == b"".join(frames)
                client.sendall(b"\x00\xffhello")
                wait_for(lambda: port.read() == b"\x00\xffhello")
            wait_for(lambda: port.read() == b"" and not port.listening)
        with pytest.raises(DeviceError, match="cannot be listened on"):
            TcpPort(address[1])
    finally:
        port.close()


@pytest.mark.parametrize("make", [PtyPort, TcpPort])
def test_a_listener_that_does_not_read_costs_whole_messages_only(make: Any) -> None:
    frame = stream(rig(), 1)[0]
    port = make()
    try:
        source = open_source(port.url)
        r = rig()
        link = source._link  # type: ignore[attr-defined]
        link.open()
        wait_for(lambda: port.listening)
        sent = 0
        began = time.monotonic()
        while port.dropped_bytes == 0 and sent < 100_000:
            port.write(frame)
            sent += 1
        assert port.dropped_bytes % len(frame) == 0 and port.dropped_bytes > 0
        # Never waits for the listener.
        assert time.monotonic() - began < 5.0
        got = b""
        end = time.monotonic() + 10
        while len(got) < (sent - 1) * len(frame) and time.monotonic() < end:
            got += link.read(0.01)
            port.read()
        assert got == frame * (sent - 1)
        # And goes on where it is read again.
        port.write(r.hello())
        assert Decoder().feed(link.read(1.0))
        link.close()
    finally:
        port.close()


@pytest.mark.parametrize("make", [PtyPort, TcpPort])
def test_a_source_opens_the_rig_over_a_real_port(make: Any) -> None:
    import threading

    r = rig()
    port = make()
    done = threading.Event()

    def serve() -> None:
        k = 0
        while not done.is_set():
            asked = port.read()
            if asked:
                port.write(r.receive(asked, k * CYCLE_US))
            if r.running and k < 20:
                port.write(r.cycle(k, k * CYCLE_US, *POSE))
                k += 1
            time.sleep(0.001)

    thread = threading.Thread(target=serve)
    thread.start()
    source = open_source(port.url)
    try:
        hello = source.open()
        assert hello.firmware == "virtual rig 1"
        cycles: list[Any] = []
        end = time.monotonic() + 60  # a busy machine
        while len(cycles) < 20 and time.monotonic() < end:
            cycles += source.poll(0.1)
        assert [c.trigger for c in cycles] == list(range(20))
        heard = acoustic_model().cycle(*POSE, 7 * CYCLE_US)
        assert all(np.array_equal(cycles[7].frames[role].iq, heard[role]) for role in heard)
        assert source.counters.bad_crc == source.counters.bad_cobs == source.counters.sequence_gaps == 0
    finally:
        source.close()
        done.set()
        thread.join(5)
        port.close()
    assert not thread.is_alive()
