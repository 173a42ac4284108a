"""Echo sources over real ptys, real loopback sockets, recordings and the same process."""

import contextlib
import os
import pty
import select
import socket
import threading
import time

import numpy as np
import pytest
from golden_frames import FRAMES

from saranga.errors import DeviceError, UsageError
from saranga.recording import FrameWriter, read_recording
from saranga.sources import FileSource, InProcessSource, LinkSource, open_source
from saranga.wire import Decoder, Echo, Fault, Hello, HelloRequest, SensorInfo, Start, Status, Stop, encode

HELLO = Hello(firmware="fake rig", sensors=tuple(
    SensorInfo(sensor=n, role=role, fop_hz=53_000.0, bandwidth_hz=3980.0) for n, role in enumerate(("left", "right"))))


def cycle_bytes(trigger, sensors=(0, 1)):
    rng = np.random.default_rng(trigger)
    return b"".join(encode(Echo(sensor=n, sequence=trigger, trigger=trigger, device_time_us=25_600 * trigger,
                                fop_hz=53_000.0, odr=6, mode=0,
                                iq=rng.integers(-9000, 9000, (256, 2)).astype(np.int16))) for n in sensors)


class FakeRig:
    """The other end: answers HELLO? and keeps what the host said. `send`, `receive` are its byte primitives."""

    def __init__(self, send, receive, hello=HELLO):
        self.send = send
        self._receive = receive
        self._hello = hello
        self.heard = []
        self._decoder = Decoder()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self):
        with contextlib.suppress(OSError):
            while data := self._receive():
                for message in self._decoder.feed(data):
                    self.heard.append(message)
                    if isinstance(message, HelloRequest) and self._hello is not None:
                        self.send(encode(self._hello))

    def wait_for(self, kind, timeout_s=3.0):
        end = time.monotonic() + timeout_s
        while time.monotonic() < end:
            found = [m for m in self.heard if isinstance(m, kind)]
            if found:
                return found[0]
            time.sleep(0.005)
        raise AssertionError(f"rig never heard {kind.__name__}: {self.heard}")


class PtyEnd:
    def __init__(self):
        self.master, slave = pty.openpty()
        self.url = f"serial://{os.ttyname(slave)}"
        self._slave = slave
        self._reading = threading.Lock()
        self._gone = False

    def send(self, data):
        while data:
            data = data[os.write(self.master, data):]

    def receive(self):
        while True:
            with self._reading:
                if self._gone:
                    return b""
                if select.select([self.master], [], [], 0.01)[0]:
                    return os.read(self.master, 4096)
            time.sleep(0.001)

    def hang_up(self):
        with self._reading:
            if not self._gone:
                self._gone = True
                os.close(self._slave)
                os.close(self.master)


class TcpEnd:
    def __init__(self):
        self._server = socket.create_server(("127.0.0.1", 0))
        self.url = f"tcp://127.0.0.1:{self._server.getsockname()[1]}"
        self._link = None
        self._ready = threading.Event()
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self):
        with contextlib.suppress(OSError):
            self._link, _ = self._server.accept()
            self._ready.set()

    def send(self, data):
        assert self._ready.wait(3)
        self._link.sendall(data)

    def receive(self):
        assert self._ready.wait(30)
        return self._link.recv(4096)

    def hang_up(self):
        self._server.close()
        if self._link is not None:
            with contextlib.suppress(OSError):
                self._link.shutdown(socket.SHUT_RDWR)
            self._link.close()


@pytest.fixture(params=[PtyEnd, TcpEnd])
def end(request):
    made = request.param()
    yield made
    made.hang_up()


def in_background(work):
    """A pty holds only some kilobytes: what is sent must be read at the same time."""
    threading.Thread(target=work, daemon=True).start()


def poll_until(source, count, timeout_s=5.0):
    cycles, limit = [], time.monotonic() + timeout_s
    while len(cycles) < count and time.monotonic() < limit:
        cycles += source.poll(0.2)
    return cycles


def test_open_asks_hello_then_starts_and_close_stops(end):
    rig = FakeRig(end.send, end.receive)
    source = open_source(end.url)
    hello = source.open()
    assert hello.firmware == "fake rig" and [s.role for s in hello.sensors] == ["left", "right"]
    start = rig.wait_for(Start)
    assert start.mode == 0 and start.rate_hz == pytest.approx(1e6 / 25_600)
    assert isinstance(rig.heard[0], HelloRequest)
    source.close()
    rig.wait_for(Stop)
    source.close()


def test_cycles_arrive_whole_and_in_order(end):
    """300 cycles, about 0.6 MB, through the real kernel device: every IQ pair as sent."""
    rig = FakeRig(end.send, end.receive)
    source = open_source(end.url)
    source.open()
    in_background(lambda: [rig.send(cycle_bytes(t)) for t in range(300)])
    cycles = poll_until(source, 300)
    assert [c.trigger for c in cycles] == list(range(300))
    for cycle in cycles[::37]:
        rng = np.random.default_rng(cycle.trigger)
        for role in ("left", "right"):
            assert np.array_equal(cycle.frames[role].iq, rng.integers(-9000, 9000, (256, 2)))
    c = source.counters
    assert (c.sequence_gaps, c.duplicates, c.bad_crc, c.bad_cobs, c.bad_message) == (0, 0, 0, 0, 0)
    assert source.cycle_counters.cycles == 300 and source.cycle_counters.incomplete == 0
    source.close()


def test_silent_source_returns_nothing_after_the_timeout(end):
    FakeRig(end.send, end.receive)
    source = open_source(end.url)
    source.open()
    begin = time.monotonic()
    assert source.poll(0.15) == []
    assert 0.14 < time.monotonic() - begin < 3.0
    begin = time.monotonic()
    assert source.poll(0.0) == []
    assert time.monotonic() - begin < 1.0
    source.close()


def test_poll_returns_with_the_first_cycle(end):
    rig = FakeRig(end.send, end.receive)
    source = open_source(end.url)
    source.open()
    threading.Timer(0.05, lambda: rig.send(cycle_bytes(1))).start()
    begin = time.monotonic()
    assert [c.trigger for c in source.poll(5.0)] == [1]
    assert time.monotonic() - begin < 2.0
    source.close()


def test_closed_peer_is_a_device_error_naming_the_url(end):
    rig = FakeRig(end.send, end.receive)
    source = open_source(end.url)
    source.open()
    rig.wait_for(Start)
    in_background(lambda: rig.send(cycle_bytes(0)))
    assert len(poll_until(source, 1)) == 1
    end.hang_up()
    with pytest.raises(DeviceError, match="lost") as caught:
        for _ in range(20):
            source.poll(0.2)
    assert end.url in str(caught.value) and "\n" not in str(caught.value)
    source.close()


def quick(url, **options):
    source = open_source(url)
    return LinkSource(source._link, hello_timeout_s=0.4, **options)


def test_mute_rig_is_named_with_the_time_waited(end):
    FakeRig(end.send, end.receive, hello=None)
    with pytest.raises(DeviceError) as caught:
        quick(end.url).open()
    for word in (end.url, "HELLO", "0.4 s", "silent", "cable"):
        assert word in str(caught.value)


def test_wrong_talker_is_told_from_a_silent_one(end):
    threading.Timer(0.1, lambda: end.send(b"$GPGGA,123519,4807.038,N\r\n" * 20)).start()
    with pytest.raises(DeviceError, match=r"520 bytes came.*baud"):
        quick(end.url).open()


def test_other_protocol_version_is_named(end):
    import struct
    import zlib

    from cobs import cobs

    body = struct.pack("<BBBBIII", 9, 1, 0, 255, 0, 0, 0)
    frame = cobs.encode(body + struct.pack("<I", zlib.crc32(body))) + b"\0"
    threading.Timer(0.1, lambda: end.send(frame)).start()
    with pytest.raises(DeviceError, match="speaks rig protocol v9, this is v1: update its firmware"):
        quick(end.url).open()


def test_status_and_faults_are_kept(end):
    rig = FakeRig(end.send, end.receive)
    source = open_source(end.url)
    source.open()
    news = encode(Status(sequence=1, overruns=4, temperature_c=23.5)) + encode(Fault(sequence=2, code=3, text="hot"))
    in_background(lambda: rig.send(news + cycle_bytes(0)))
    assert len(poll_until(source, 1)) == 1
    assert source.status.temperature_c == 23.5 and source.counters.overruns == 4
    assert [f.text for f in source.faults] == ["hot"]
    source.close()


def test_live_recording_replays_the_same(end, tmp_path):
    rig = FakeRig(end.send, end.receive)
    source = open_source(end.url, record=tmp_path / "live.mcap")
    source.open()
    in_background(lambda: [rig.send(b"\x03!\0" if t == 20 else cycle_bytes(t)) for t in range(40)])
    live = poll_until(source, 39)
    source.close()
    replay = FileSource(tmp_path / "live.mcap")
    assert replay.open().firmware == "fake rig"
    again = []
    while not replay.exhausted:
        again += replay.poll(0.0)
    assert [c.trigger for c in again] == [c.trigger for c in live] and len(again) == 39
    assert all(np.array_equal(a.frames["left"].iq, b.frames["left"].iq) for a, b in zip(live, again, strict=True))
    assert replay.counters == source.counters and replay.counters.bad_cobs + replay.counters.bad_crc == 1
    assert replay.complete


def test_recording_is_closed_when_open_fails(end, tmp_path):
    FakeRig(end.send, end.receive, hello=None)
    with pytest.raises(DeviceError):
        quick(end.url, record=tmp_path / "x.mcap").open()
    recording = read_recording(tmp_path / "x.mcap")
    assert list(recording.frames()) == [] and recording.complete


def test_absent_peers_are_named(tmp_path):
    with pytest.raises(DeviceError, match=r"serial:///dev/nosuchrig: cannot be opened.*plugged in"):
        open_source("serial:///dev/nosuchrig").open()
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with pytest.raises(DeviceError, match=rf"tcp://127\.0\.0\.1:{port}: cannot connect"):
        open_source(f"tcp://127.0.0.1:{port}").open()
    with pytest.raises(DeviceError, match="open it first"):
        open_source(f"tcp://127.0.0.1:{port}").poll(0.0)


def test_port_in_use_is_refused():
    end = PtyEnd()
    FakeRig(end.send, end.receive)
    first = open_source(end.url)
    first.open()
    with pytest.raises(DeviceError, match="cannot be opened"):
        open_source(end.url).open()
    first.close()
    end.hang_up()


@pytest.mark.parametrize("url", ["", "rig", "/dev/ttyACM0", "serial://", "serial://ttyACM0", "tcp://host", "tcp://:5",
                                 "tcp://host:99999", "tcp://host:port", "tcp://h:5/x", "udp://h:5", "http://h:80",
                                 "serial:///dev/ttyACM0?baud=fast", "serial:///dev/ttyACM0?speed=9600"])
def test_malformed_url_lists_the_forms(url):
    with pytest.raises(UsageError) as caught:
        open_source(url)
    for word in (repr(url), "serial:///dev/ttyACM0", "tcp://host:port", "file:recording.mcap"):
        assert word in str(caught.value)


# ---- recording as a source -------------------------------------------------------------------------------------
def test_file_source_errors(tmp_path):
    with pytest.raises(UsageError, match="does not exist"):
        open_source(f"file:{tmp_path}/none.mcap")
    with FrameWriter(tmp_path / "mute.mcap") as writer:
        writer.write(cycle_bytes(0), 0)
    with pytest.raises(UsageError, match="no HELLO in the recording"):
        open_source(f"file:{tmp_path}/mute.mcap").open()
    with pytest.raises(UsageError, match="cannot be recorded again"):
        open_source(f"file:{tmp_path}/mute.mcap", record=tmp_path / "y.mcap")


def test_file_source_gives_one_cycle_a_poll_and_the_incomplete_last(tmp_path):
    with FrameWriter(tmp_path / "a.mcap") as writer:
        writer.write(encode(HELLO), 0)
        for trigger in range(3):
            writer.write(cycle_bytes(trigger, (0, 1) if trigger < 2 else (0,)), 25_600 * trigger)
    source = FileSource(tmp_path / "a.mcap")
    source.open()
    polls = [source.poll(0.0) for _ in range(5)]
    # The incomplete last one comes with the end of the file.
    assert [[c.trigger for c in p] for p in polls] == [[0], [1], [2], [], []]
    assert list(polls[2][0].frames) == ["left"] and source.exhausted
    source.close()


def test_url_of_a_recording_plays_at_its_own_pace(tmp_path):
    """20 cycles of 25.6 ms take 19 x 25.6 = 486 ms, however short the polls are."""
    with FrameWriter(tmp_path / "a.mcap") as writer:
        writer.write(encode(HELLO) + b"".join(map(cycle_bytes, range(20))), 0)
    source = open_source(f"file:{tmp_path / 'a.mcap'}")
    source.open()
    begin, cycles, silent = time.monotonic(), [], 0
    while not source.exhausted:
        got = source.poll(0.005)
        silent += not got
        cycles += got
    assert [c.trigger for c in cycles] == list(range(20))
    assert 0.48 < time.monotonic() - begin < 5.0 and silent > 20


def test_cut_recording_still_plays(tmp_path):
    path = tmp_path / "a.mcap"
    with FrameWriter(path) as writer:
        writer.write(encode(HELLO), 0)
        for trigger in range(200):
            writer.write(cycle_bytes(trigger), 25_600 * trigger)
    data = path.read_bytes()
    path.write_bytes(data[:len(data) // 2])
    source = FileSource(path)
    source.open()
    cycles = []
    while not source.exhausted:
        cycles += source.poll(0.0)
    assert 60 < len(cycles) <= 100 and not source.complete
    assert [c.trigger for c in cycles] == list(range(len(cycles)))


# ---- in process ------------------------------------------------------------------------------------------------
def test_in_process_by_feeding():
    source = InProcessSource()
    with pytest.raises(DeviceError, match="no HELLO"):
        source.open()
    source.feed(encode(HELLO))
    assert source.open().firmware == "fake rig"
    source.feed(cycle_bytes(0) + cycle_bytes(1)[:700])
    assert [c.trigger for c in source.poll(0.0)] == [0]
    source.feed(cycle_bytes(1)[700:])
    assert [c.trigger for c in source.poll(0.0)] == [1] and source.poll(9.0) == []


def test_in_process_with_an_answering_rig():
    heard = []

    def answer(data):
        heard.extend(Decoder().feed(data))
        return encode(HELLO) if isinstance(heard[-1], HelloRequest) else b""

    source = InProcessSource(answer)
    assert source.open() == HELLO
    source.close()
    source.close()
    assert [type(m) for m in heard] == [HelloRequest, Start, Stop]


def test_in_process_survives_what_a_link_may_do():
    source = InProcessSource()
    source.feed(FRAMES["hello"] + b"\xff\xfe\0\0" + cycle_bytes(0) + cycle_bytes(0) + cycle_bytes(2))
    assert [c.trigger for c in source.poll()] == [0, 2]
    assert source.counters.duplicates == 2 and source.counters.sequence_gaps == 2
    assert source.cycle_counters.missing == 1
