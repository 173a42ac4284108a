"""Rig protocol v1: golden bytes, round trips, and a decoder that survives anything."""

import math
import struct
import tracemalloc

import numpy as np
import pytest
from golden_frames import FRAMES, MESSAGES
from hypothesis import given, settings
from hypothesis import strategies as st

from saranga.errors import UsageError
from saranga.wire import (
    FLAG_BOOT,
    MAX_FRAME_BYTES,
    MAX_SAMPLES,
    Config,
    Decoder,
    Echo,
    Fault,
    Hello,
    LinkCounters,
    SensorInfo,
    Stand,
    Start,
    Status,
    Throttle,
    encode,
)


def bitwise_crc32(data: bytes) -> int:
    """CRC-32 written from its polynomial, to hold zlib's use against."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xEDB88320 if crc & 1 else 0)
    return crc ^ 0xFFFFFFFF


def plain_uncobs(frame: bytes) -> bytes:
    """COBS as its definition says it, without the closing zero."""
    out, at = bytearray(), 0
    while at < len(frame):
        code = frame[at]
        out += frame[at + 1:at + code]
        at += code
        if code < 255 and at < len(frame):
            out.append(0)
    return bytes(out)


def plain_cobs(data: bytes) -> bytes:
    out = bytearray()
    for n, run in enumerate(pieces := data.split(b"\0")):
        while len(run) >= 254:
            out += b"\xff" + run[:254]
            run = run[254:]
            if not run and n == len(pieces) - 1:
                return bytes(out)
        out += bytes([len(run) + 1]) + run
    return bytes(out)


def sealed(body: bytes) -> bytes:
    """A frame with a valid CRC around any body, made without the code under test."""
    return plain_cobs(body + struct.pack("<I", bitwise_crc32(body))) + b"\0"


def same(a, b) -> bool:
    """Equal field by field; a NaN equals a NaN."""
    if type(a) is not type(b):
        return False
    if isinstance(a, Echo):
        return a.iq.dtype == b.iq.dtype and np.array_equal(a.iq, b.iq) and all(
            getattr(a, f) == getattr(b, f)
            for f in ("sensor", "sequence", "trigger", "device_time_us", "flags", "fop_hz", "odr", "mode"))
    return repr(a) == repr(b)


def echo(sensor=0, sequence=0, trigger=0, n=8, fill=0):
    iq = np.full((n, 2), fill, np.int16)
    return Echo(sensor=sensor, sequence=sequence, trigger=trigger, device_time_us=25_600 * trigger, fop_hz=53_000.0,
                odr=6, mode=0, iq=iq)


# ---- layout ----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", MESSAGES)
def test_golden_frames(name):
    assert encode(MESSAGES[name]).hex() == FRAMES[name].hex()
    decoder = Decoder()
    (message,) = decoder.feed(FRAMES[name])
    assert same(message, MESSAGES[name])
    assert decoder.counters.messages == 1 and decoder.counters.bytes_in == len(FRAMES[name])


@pytest.mark.parametrize("name", FRAMES)
def test_golden_frames_by_hand(name):
    """Header and CRC, read by an independent COBS and CRC."""
    assert FRAMES[name][-1] == 0 and 0 not in FRAMES[name][:-1]
    body = plain_uncobs(FRAMES[name][:-1])
    code = {"hello": 1, "echo": 2, "status": 3, "stand": 4, "fault": 5, "hello_request": 0x81, "config": 0x82,
            "start": 0x83, "stop": 0x84, "self_test": 0x85, "throttle": 0x86}[name]
    assert body[:2] == bytes([1, code])
    assert int.from_bytes(body[-4:], "little") == bitwise_crc32(body[:-4])


def test_echo_layout_by_hand():
    body = plain_uncobs(FRAMES["echo"][:-1])
    assert body[2:16] == bytes.fromhex("01 01 04030201 0d0c0b0a feffffff")  # flags, sensor, sequence, trigger, time
    assert struct.unpack_from("<f", body, 16) == (53_000.0,)
    assert body[20:24] == bytes([6, 1, 3, 0])  # ODR, mode, n
    assert struct.unpack_from("<6h", body, 24) == (0, 0, 1, -2, 256, -20984)  # Q, I, Q, I, ...
    assert len(body) == 16 + 8 + 12 + 4


def test_throttle_and_stand_layout_by_hand():
    assert struct.unpack_from("<fIH", plain_uncobs(FRAMES["throttle"][:-1]), 16) == (0.5, 0x01000002, 250)
    stand = plain_uncobs(FRAMES["stand"][:-1])
    assert struct.unpack_from("<8fI", stand, 16) == (1.25, 0.5, 12000, 16, 4.5, 40, 35.5, 0.25, 0xDEADBEEF)
    assert len(stand) == 16 + 36 + 4


def test_u32_fields_wrap():
    (message,) = Decoder().feed(encode(echo(sequence=1 << 32, trigger=(1 << 32) + 7)))
    assert message.sequence == 0 and message.trigger == 7 and message.device_time_us == (25_600 * 7) % (1 << 32)


def test_longest_frame_fits():
    frame = encode(echo(n=MAX_SAMPLES, fill=0x0101))
    assert len(frame) == 2748 + math.ceil(2748 / 254) + 1 <= MAX_FRAME_BYTES
    assert len(Decoder().feed(frame)) == 1


@pytest.mark.parametrize(("message", "words"), [
    (Throttle(value=1.5, token=0, deadline_ms=100), ["Throttle", "value", "1.5", "0..1"]),
    (Throttle(value=math.nan, token=0, deadline_ms=100), ["Throttle", "value", "nan"]),
    (Throttle(value=0.5, token=0, deadline_ms=0), ["deadline_ms", "1..5000"]),
    (Throttle(value=0.5, token=-1, deadline_ms=9), ["Throttle"]),
    (Start(rate_hz=1000.0), ["Start", "rate_hz", "1000", "0.1..200"]),
    (Start(mode=2), ["Start", "mode", "2"]),
    (Config(odr=1, samples=256), ["Config", "odr", "2..6"]),
    (Config(odr=6, samples=681), ["Config", "samples", "681"]),
    (Fault(code=70_000), ["Fault"]),
    (Fault(code=1, text="x" * 201), ["text", "200"]),
    (echo(n=681), ["Echo", "681"]),
    (echo(sensor=256), ["Echo"]),
    (Hello(firmware="f", sensors=(SensorInfo(sensor=0, role="up", fop_hz=53e3, bandwidth_hz=4e3),)), ["role", "up"]),
    (Hello(firmware="f", sensors=(SensorInfo(sensor=0, role="", fop_hz=53.0, bandwidth_hz=4e3),)), ["fop_hz"]),
    (Hello(firmware="f", sensors=tuple(SensorInfo(sensor=n, role="left", fop_hz=53e3, bandwidth_hz=4e3)
                                       for n in (0, 1))), ["different roles"]),
])
def test_what_cannot_be_sent_is_named(message, words):
    with pytest.raises(UsageError) as caught:
        encode(message)
    for word in words:
        assert word in str(caught.value)


# ---- round trips -----------------------------------------------------------------------------------------------
u32 = st.integers(0, 0xFFFFFFFF)
f32 = st.floats(width=32)
header = {"sensor": st.integers(0, 255), "sequence": u32, "trigger": u32, "device_time_us": u32,
          "flags": st.integers(0, 255)}


def short_text(most):
    return st.text(st.characters(codec="utf-8"), max_size=most // 4)


infos = st.builds(SensorInfo, sensor=st.integers(0, 254), role=st.sampled_from(["left", "right", "down", ""]),
                  fop_hz=st.floats(20_000, 200_000, width=32), bandwidth_hz=st.floats(1, 100_000, width=32),
                  self_test=st.sampled_from(["untested", "pass", "fail"]), transmits=st.booleans(),
                  serial=short_text(32))
messages = st.one_of(
    st.builds(Hello, firmware=short_text(64), has_stand=st.booleans(), has_throttle=st.booleans(), **header,
              sensors=st.lists(infos, max_size=4, unique_by=(lambda s: s.sensor, lambda s: s.role or s.sensor))
              .map(tuple)),
    st.builds(Echo, fop_hz=st.floats(20_000, 200_000, width=32), odr=st.integers(2, 6), mode=st.integers(0, 1),
              iq=st.binary(min_size=4, max_size=400).map(
                  lambda b: np.frombuffer(b[:len(b) // 4 * 4], np.int16).reshape(-1, 2)), **header),
    st.builds(Status, overruns=u32, host_errors=u32, cycles=u32, temperature_c=f32, state=st.integers(0, 2),
              **header),
    st.builds(Stand, thrust_n=f32, torque_n_m=f32, rpm=f32, voltage_v=f32, current_a=f32, esc_temperature_c=f32,
              motor_temperature_c=f32, throttle=f32, token=u32, **header),
    st.builds(Fault, code=st.integers(0, 65_535), text=short_text(200), latched=st.booleans(), **header),
    st.builds(Config, odr=st.integers(2, 6), samples=st.integers(1, 680), ring_down_samples=st.integers(0, 680),
              **header),
    st.builds(Start, mode=st.integers(0, 1), rate_hz=st.floats(0.5, 200, width=32), **header),
    st.builds(Throttle, value=st.floats(0, 1, width=32), token=u32, deadline_ms=st.integers(1, 5000), **header),
    st.sampled_from(list(MESSAGES.values())),
)


@settings(max_examples=150, deadline=None)
@given(messages)
def test_any_message_comes_back(message):
    (back,) = Decoder().feed(encode(message))
    assert same(back, message)


# ---- rubbish ---------------------------------------------------------------------------------------------------
def clean(counters: LinkCounters) -> bool:
    return counters.bad_cobs == counters.bad_crc == counters.bad_message == 0


@settings(max_examples=200, deadline=None)
@given(st.lists(st.binary(max_size=200), max_size=8))
def test_random_bytes_yield_nothing_and_the_next_frame_is_taken(chunks):
    decoder = Decoder()
    for chunk in chunks:
        assert decoder.feed(chunk) == []
    decoder.feed(b"\0")
    (message,) = decoder.feed(FRAMES["status"])
    assert same(message, MESSAGES["status"])
    pieces = [piece for piece in b"".join(chunks).split(b"\0") if piece]
    c = decoder.counters
    assert c.bad_cobs + c.bad_crc + c.bad_message == len(pieces)
    assert c.bytes_in == sum(map(len, chunks)) + 1 + len(FRAMES["status"]) and c.messages == 1


@settings(max_examples=100, deadline=None)
@given(st.lists(st.sampled_from(list(FRAMES)), min_size=1, max_size=6), st.data())
def test_any_cut_gives_the_same_messages(names, data):
    stream = b"".join(FRAMES[name] for name in names)
    whole, pieces = Decoder(), Decoder()
    expected = whole.feed(stream)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=12)))
    got = []
    for start, end in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        got += pieces.feed(stream[start:end])
    assert len(got) == len(expected) and all(map(same, got, expected))
    assert whole.counters == pieces.counters and clean(whole.counters)


def test_byte_by_byte():
    decoder, got = Decoder(), []
    for byte in b"".join(FRAMES.values()):
        got += decoder.feed(bytes([byte]))
    assert [type(m) for m in got] == [type(m) for m in MESSAGES.values()]


@pytest.mark.parametrize("name", ["throttle", "status", "echo", "hello"])
def test_no_single_byte_error_is_accepted(name):
    """Every byte of the frame, closing zero included, replaced by every other value."""
    frame, after = FRAMES[name], FRAMES["stop"]
    for at in range(len(frame)):
        for value in range(256):
            if value == frame[at]:
                continue
            decoder = Decoder()
            got = decoder.feed(frame[:at] + bytes([value]) + frame[at + 1:] + after + after)
            # An error in the closing zero glues the next frame to this one; the one after that must come.
            assert all(same(m, MESSAGES["stop"]) for m in got)
            assert len(got) == (1 if at == len(frame) - 1 else 2)
            c = decoder.counters
            assert c.bad_cobs + c.bad_crc + c.bad_message >= 1


@settings(max_examples=200, deadline=None)
@given(st.sampled_from(["throttle", "stand", "echo", "hello"]), st.data())
def test_truncated_or_multiply_damaged_frames_are_never_accepted(name, data):
    frame = bytearray(FRAMES[name])
    if data.draw(st.booleans()):
        start = data.draw(st.integers(0, len(frame) - 2))
        del frame[start:data.draw(st.integers(start + 1, len(frame) - 1))]
    else:
        for _ in range(data.draw(st.integers(2, 10))):
            frame[data.draw(st.integers(0, len(frame) - 2))] ^= data.draw(st.integers(1, 255))
    if bytes(frame) == FRAMES[name]:
        return
    got = Decoder().feed(bytes(frame) + FRAMES["config"])
    assert [type(m) for m in got] == [Config]


def test_garbage_between_frames_costs_only_itself():
    decoder = Decoder()
    got = decoder.feed(FRAMES["stop"] + b"\x05ab\0" + FRAMES["start"] + b"\0\0\0" + b"\x02x\0" + FRAMES["stop"])
    assert len(got) == 3
    assert decoder.counters.bad_cobs == 1 and decoder.counters.bad_crc == 1 and decoder.counters.bad_message == 0


def payload_of(code: int, payload: bytes, version: int = 1) -> bytes:
    return sealed(struct.pack("<BBBBIII", version, code, 0, 0, 0, 0, 0) + payload)


@pytest.mark.parametrize("frame", [
    payload_of(0x7F, b""), payload_of(0x84, b"x"), payload_of(0x83, b"\0"),
    payload_of(0x83, struct.pack("<Bf", 2, 39.0)), payload_of(0x83, struct.pack("<Bf", 0, math.nan)),
    payload_of(0x86, struct.pack("<fIH", 1.01, 0, 10)), payload_of(0x86, struct.pack("<fIH", math.inf, 0, 10)),
    payload_of(0x02, struct.pack("<fBBH", 53e3, 6, 0, 3) + bytes(8)),
    payload_of(0x02, struct.pack("<fBBH", 53e3, 6, 0, 0)), payload_of(0x02, struct.pack("<fBBH", 53e3, 6, 0, 681)),
    payload_of(0x02, struct.pack("<fBBH", 53e3, 1, 0, 1) + bytes(4)),
    payload_of(0x02, struct.pack("<fBBH", math.nan, 6, 0, 1) + bytes(4)),
    payload_of(0x01, b""), payload_of(0x01, b"\x09short"), payload_of(0x01, b"\x01\xff\0\0"),
    payload_of(0x01, b"\0\0\x02"), payload_of(0x01, b"\0\0\0extra"), payload_of(0x05, b"\0\0\x02\0"),
    payload_of(0x05, b"\0\0\0\x05abc"), payload_of(0x84, b"", version=2),
])
def test_valid_crc_but_impossible_content_is_a_bad_message(frame):
    decoder = Decoder()
    assert decoder.feed(frame) == []
    assert (decoder.counters.bad_message, decoder.counters.bad_crc, decoder.counters.bad_cobs) == (1, 0, 0)


def test_foreign_version_is_remembered():
    decoder = Decoder()
    decoder.feed(payload_of(0x84, b"", version=2))
    assert decoder.foreign_version == 2


def test_endless_stream_without_zero_needs_bounded_memory():
    decoder = Decoder()
    chunk = b"\x55" * 1000
    decoder.feed(chunk)
    tracemalloc.start()
    for _ in range(20_000):
        assert decoder.feed(chunk) == []
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 4 * MAX_FRAME_BYTES
    assert decoder.counters.bad_cobs == 1 and decoder.counters.bytes_in == 20_001_000
    # The rest of that run is thrown away with it, and then all is well.
    assert [type(m) for m in decoder.feed(b"\x55\0" + FRAMES["config"])] == [Config]
    assert decoder.counters.bad_cobs == 1


# ---- sequence numbers ------------------------------------------------------------------------------------------
def fed(*sequences, sensor=0, decoder=None):
    decoder = decoder or Decoder()
    got = [m.sequence for s in sequences for m in decoder.feed(encode(echo(sensor=sensor, sequence=s, trigger=s)))]
    return got, decoder.counters


def test_gaps_are_counted_per_sensor():
    decoder = Decoder()
    fed(0, 1, 4, sensor=0, decoder=decoder)
    fed(10, 11, 12, sensor=1, decoder=decoder)
    _, counters = fed(5, sensor=0, decoder=decoder)
    assert counters.sequence_gaps == 2 and counters.gaps_by_sensor == {0: 2} and counters.duplicates == 0


def test_duplicates_are_dropped_and_counted():
    got, counters = fed(0, 1, 1, 2, 0, 3)
    assert got == [0, 1, 2, 3] and counters.duplicates == 2 and counters.sequence_gaps == 0


def test_status_said_twice_is_no_duplicate():
    decoder = Decoder()
    assert len(decoder.feed(FRAMES["status"] * 2 + FRAMES["stand"] * 2)) == 3
    assert decoder.counters.duplicates == 1


def test_late_frame_is_taken_and_is_no_gap():
    got, counters = fed(0, 2, 1, 3)
    assert got == [0, 2, 1, 3] and counters.sequence_gaps == 0 and counters.duplicates == 0


def test_sequence_wraps():
    got, counters = fed(0xFFFFFFFE, 0xFFFFFFFF, 0, 2)
    assert got == [0xFFFFFFFE, 0xFFFFFFFF, 0, 2] and counters.sequence_gaps == 1 and counters.restarts == 0


def test_restart_is_noticed_with_and_without_hello():
    got, counters = fed(1000, 1001, 0, 1)
    assert got == [1000, 1001, 0, 1] and counters.restarts == 1 and counters.sequence_gaps == 0
    decoder = Decoder()
    fed(0, 1, 2, decoder=decoder)
    decoder.feed(encode(Hello(firmware="x", sensors=(), flags=FLAG_BOOT)))
    got, counters = fed(0, 1, decoder=decoder)
    assert got == [0, 1] and counters.restarts == 1 and counters.duplicates == 0


def test_host_messages_are_not_counted_by_sequence():
    decoder = Decoder()
    assert len(decoder.feed(FRAMES["start"] * 3)) == 3
    assert decoder.counters.duplicates == 0 and decoder.counters.sequence_gaps == 0


def test_overruns_are_the_devices_own_count():
    decoder = Decoder()
    decoder.feed(encode(Status(sequence=0, overruns=2, host_errors=4)) + encode(Status(sequence=1, overruns=5)))
    assert decoder.counters.overruns == 5 and decoder.counters.host_errors == 0


@settings(max_examples=60, deadline=None)
@given(st.lists(st.sampled_from(["keep", "keep", "keep", "drop", "repeat", "corrupt"]), max_size=80))
def test_counters_tell_what_the_link_did(fates):
    """What was dropped or corrupted between two received frames is a gap; what was repeated is a duplicate."""
    decoder, stream, taken = Decoder(), b"", []
    for sequence, fate in enumerate(fates):
        frame = encode(echo(sequence=sequence, trigger=sequence, fill=sequence))
        if fate == "corrupt":
            stream += frame[:9] + bytes([frame[9] ^ 0x40 or 1]) + frame[10:]
        elif fate != "drop":
            stream += frame * (2 if fate == "repeat" else 1)
            taken.append(sequence)
    got = [m.sequence for m in decoder.feed(stream)]
    assert got == taken
    c = decoder.counters
    assert c.duplicates == fates.count("repeat") and c.messages == len(taken)
    assert c.bad_cobs + c.bad_crc + c.bad_message >= fates.count("corrupt")
    assert c.sequence_gaps == (taken[-1] - taken[0] + 1 - len(taken) if taken else 0)
