"""The firmware's portable C++ on the host, under sanitizers: byte for byte as `saranga/wire.py`, and never fooled."""

import shutil
import struct
import subprocess
import zlib
from pathlib import Path

import numpy as np
import pytest
from cobs import cobs
from golden_frames import FRAMES

from bench.rig.throttle_keeper import ThrottleKeeper
from bench.thrust_stand import kiss
from saranga.framing import Decoder
from saranga.messages import Message
from saranga.wire import Echo, Fault, Hello, HelloRequest, SensorInfo, Stand, Start, Status, Throttle, encode

ROOT = Path(__file__).resolve().parents[2]
SOURCES = ROOT / "bench" / "firmware" / "saranga_rig"
COMPILER = shutil.which("g++") or shutil.which("c++") or shutil.which("clang++")
STRICT = ["-std=c++17", "-Wall", "-Wextra", "-Wconversion", "-Werror"]

pytestmark = [pytest.mark.xdist_group("firmware"),
              pytest.mark.skipif(COMPILER is None, reason="no C++ compiler here: apt install g++")]


@pytest.fixture(scope="module")
def tool(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`firmware_tool.cpp` with address and undefined behaviour sanitizers; any finding ends it with an error."""
    out = tmp_path_factory.mktemp("firmware") / "tool"
    source = Path(__file__).with_name("firmware_tool.cpp")
    done = subprocess.run([str(COMPILER), *STRICT, "-O1", "-g", "-fsanitize=address,undefined",
                           "-fno-sanitize-recover=all", "-I", str(SOURCES / "src"), str(source), "-o", str(out)],
                          capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return out


def run(tool: Path, *arguments: str, data: bytes = b"", timeout: float = 200.0) -> tuple[bytes, str]:
    done = subprocess.run([str(tool), *arguments], input=data, capture_output=True, timeout=timeout)
    assert done.returncode == 0, done.stderr.decode() + done.stdout.decode()
    return done.stdout, done.stderr.decode()


class EveryFrame(Decoder):
    """The Python decoder without its memory of sequence numbers, which the device does not have."""

    def _fresh(self, message: Message) -> bool:
        return True


def python_decode(data: bytes) -> tuple[bytes, str]:
    decoder = EveryFrame()
    messages = decoder.feed(data)
    counters = decoder.counters
    return b"".join(map(encode, messages)), f"{counters.bad_cobs} {counters.bad_crc} {counters.bad_message}\n"


def random_messages(rng: np.random.Generator, count: int) -> list[Message]:
    def number() -> int:
        return int(rng.integers(2**32))

    made: list[Message] = []
    for _ in range(count):
        header = {"sensor": int(rng.integers(256)), "sequence": number(), "trigger": number(),
                  "device_time_us": number(), "flags": int(rng.integers(256))}
        kind = int(rng.integers(7))
        if kind == 0:
            n = int(rng.integers(1, 681))
            # Many zeros, and runs of 254 and more without: every way that COBS has.
            iq = (rng.integers(-32768, 32768, (n, 2)) * (rng.random((n, 2)) < rng.choice([0.1, 0.9, 1.0])))
            made.append(Echo(fop_hz=float(rng.uniform(20e3, 200e3)), odr=int(rng.integers(2, 7)),
                             mode=int(rng.integers(2)), iq=iq.astype(np.int16), **header))
        elif kind == 1:
            made.append(Throttle(value=float(np.float32(rng.random())), token=number(),
                                 deadline_ms=int(rng.integers(1, 5001)), **header))
        elif kind == 2:
            made.append(Fault(code=int(rng.integers(65536)), text="ä" * int(rng.integers(101)), **header))
        elif kind == 3:
            made.append(Stand(thrust_n=float(rng.normal()), token=number(), **header))
        elif kind == 4:
            sensors = tuple(SensorInfo(sensor=k, role=role, fop_hz=53e3, bandwidth_hz=4e3, serial="s" * k)
                            for k, role in enumerate(("left", "right", "down")[:int(rng.integers(4))]))
            made.append(Hello(firmware="f" * int(rng.integers(65)), sensors=sensors, **header))
        elif kind == 5:
            made.append(Start(mode=int(rng.integers(2)), rate_hz=float(rng.uniform(0.1, 200)), **header))
        else:
            made.append(HelloRequest(**header) if rng.random() < 0.5 else Status(cycles=number(), **header))
    return made


def test_every_golden_frame_is_taken_and_made_again_byte_for_byte(tool):
    data = b"".join(FRAMES.values())
    out, counters = run(tool, "decode", data=data)
    assert out == data and counters == "0 0 0\n"


def test_random_messages_are_the_same_bytes_on_both_sides(tool):
    data = b"".join(map(encode, random_messages(np.random.default_rng(1), 400)))
    out, counters = run(tool, "decode", data=data)
    assert counters == "0 0 0\n" and out == data == python_decode(data)[0]


def test_both_decoders_take_and_count_the_same_of_corrupted_streams(tool):
    rng = np.random.default_rng(2)
    stream = bytearray()
    for message in random_messages(rng, 1500):
        frame = bytearray(encode(message))
        for _ in range(int(rng.integers(3))):
            at = int(rng.integers(len(frame)))
            change = int(rng.integers(5))
            if change == 0:
                frame[at] ^= 1 << int(rng.integers(8))
            elif change == 1:
                del frame[at:at + int(rng.integers(1, 9))]
            elif change == 2:
                frame[at:at] = rng.bytes(int(rng.integers(1, 9)))
            elif change == 3 and rng.random() < 0.02:
                frame[at:at] = bytes([7]) * 5000
            if not frame:
                break
        stream += frame
    assert run(tool, "decode", data=bytes(stream)) == python_decode(bytes(stream))


def test_contents_that_cannot_be_are_refused_on_both_sides(tool):
    """Right CRC, wrong contents: every byte of every golden frame's body set to 0, 127 and 255 in turn."""
    stream = b""
    for frame in FRAMES.values():
        body = cobs.decode(frame[:-1])[:-4]
        for at in range(len(body)):
            for value in (0x00, 0x7F, 0xFF):
                wrong = body[:at] + bytes([value]) + body[at + 1:]
                # Python's double does not keep the bits of a signalling NaN: STATUS and STAND with one are left out.
                if body[1] in (0x03, 0x04) and 16 <= at < len(body) - 1 and value:
                    continue
                stream += cobs.encode(wrong + struct.pack("<I", zlib.crc32(wrong))) + b"\0"
        for size in range(len(body)):
            stream += cobs.encode(body[:size] + struct.pack("<I", zlib.crc32(body[:size]))) + b"\0"
    assert run(tool, "decode", data=stream) == python_decode(stream)


def check_fuzz(tool: Path, count: int, timeout: float) -> None:
    out, _ = run(tool, "fuzz", str(count), "1", timeout=timeout)
    words = out.decode().split()
    assert words[0] == str(count) and " 0 false frames, 0 not resynchronised" in out.decode(), out


def test_twenty_thousand_corrupted_inputs_give_the_firmware_no_false_frame(tool):
    check_fuzz(tool, 20_000, 200.0)


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_a_million_corrupted_inputs_give_the_firmware_no_false_frame(tool):
    check_fuzz(tool, 1_000_000, 1700.0)


def test_the_dead_man_keeps_the_rules_of_the_emulator(tool):
    rng = np.random.default_rng(3)
    keeper = ThrottleKeeper()
    now = 2**32 - 3_000_000
    lines, expected = [], []
    for token in range(1, 2000):
        now += int(rng.integers(0, 400_000))
        if keeper.expires_us <= now:
            keeper.idle()
            expected.append((1, 0.0, 0))
        else:
            expected.append((0, keeper.applied, keeper.token))
        lines.append(f"t {now % 2**32}")
        if rng.random() < 0.7:
            value = float(np.float32(rng.choice([0.0, rng.random(), 1.0])))
            message = Throttle(value=value, token=token, deadline_ms=int(rng.integers(1, 500)))
            keeper.command(message, now)
            lines.append(f"c {value:.9g} {token} {message.deadline_ms} {now % 2**32}")
            expected.append((0, value, token))
    out, _ = run(tool, "deadman", data="\n".join(lines).encode())
    found = [(int(e), float(v), int(t)) for e, v, t in (line.split() for line in out.decode().splitlines())]
    assert found == [(e, pytest.approx(v, abs=1e-7), t) for e, v, t in expected]
    assert sum(e for e, _, _ in found) > 100


def test_the_dead_man_takes_no_throttle_that_is_none(tool):
    out, _ = run(tool, "deadman", data=b"c 0.5 1 100 0\nc nan 2 100 10\nc 0.5 3 100 20\nc 1.5 4 100 30\nc -1 5 9 40\n")
    assert [line.split()[1] for line in out.decode().splitlines()] == ["0.5", "0", "0.5", "0", "0"]
    out, _ = run(tool, "pulse", "1000", "2000", data=b"0\n0.5\n1\nnan\n-0.1\n1.1\n")
    assert [float(x) for x in out.split()] == [1000, 1500, 2000, 1000, 1000, 1000]


def test_esc_telemetry_is_read_as_the_python_side_reads_it(tool):
    rng = np.random.default_rng(4)
    stream = rng.bytes(7)
    for k in range(300):
        sent = kiss.EscTelemetry(float(rng.integers(-20, 120)), k * 0.01, float(k), k, 100 * int(rng.integers(1, 2000)))
        frame = bytearray(kiss.encode(sent))
        if rng.random() < 0.1:
            frame[int(rng.integers(10))] ^= 1 << int(rng.integers(8))
        if rng.random() < 0.05:
            del frame[int(rng.integers(10)):]
        stream += bytes(frame)
    python = kiss.KissDecoder()
    expected = [(t.temperature_c, t.voltage_v, t.current_a, t.charge_mah, t.rpm(14)) for t in python.feed(stream)]
    out, _ = run(tool, "kiss", "14", data=stream)
    found = [tuple(map(float, line.split())) for line in out.decode().splitlines()]
    assert len(found) > 200
    # What follows a lost frame is held back until it is confirmed: the last may be missing on either side.
    count = min(len(found), len(expected))
    assert abs(len(found) - len(expected)) <= 1
    for mine, theirs in zip(found[:count], expected[:count], strict=True):
        assert mine == pytest.approx(theirs, rel=1e-6)


def test_load_cell_counts_and_newtons(tool):
    out, _ = run(tool, "hx711", "1000", "-500", data=b"0003e8\n7ffffe\nffffff\n800001\n7fffff\n800000\n")
    rows = [line.split() for line in out.decode().splitlines()]
    assert [int(r[0]) for r in rows] == [1000, 8388606, -1, -8388607, 8388607, -8388608]
    assert [float(r[1]) for r in rows[:3]] == pytest.approx([0.0, (8388606 - 1000) / -500, 1001 / 500])
    assert [r[1].strip("-") for r in rows[4:]] == ["nan", "nan"]
    out, _ = run(tool, "hx711", "0", "0", data=b"000001\n")
    assert out.decode().split()[1].strip("-") == "nan"


def test_the_sketch_compiles_against_declarations_of_arduino_and_soniclib(tmp_path):
    """Not the real headers, which are the user's: syntax, types and names of what the sketch itself is made of."""
    mocks = Path(__file__).with_name("mock_headers")
    for source in sorted(SOURCES.glob("*.ino")) + sorted(SOURCES.glob("*.cpp")):
        done = subprocess.run([str(COMPILER), "-std=c++17", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", "-x", "c++",
                               "-I", str(mocks), "-I", str(SOURCES), str(source)], capture_output=True, text=True)
        assert done.returncode == 0, f"{source.name}: {done.stderr}"
