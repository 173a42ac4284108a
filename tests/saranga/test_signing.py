"""MAVLink 2 signing: what the key lets in and what it keeps out."""

import hashlib
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from saranga.errors import UsageError
from saranga.navigate import VelocityCommand
from saranga.signing import EPOCH_S, NEW_STREAM_TICKS, TICKS_A_SECOND, SigningMavlink, load_sign_key
from saranga.vehicle import VehicleLink

KEY, OTHER = bytes(range(32)), bytes(32)
NOW_S = EPOCH_S + 1e6


def vehicle(key: bytes | None = KEY, now_s: float = NOW_S) -> mavlink.MAVLink:
    if key is None:
        return mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    return SigningMavlink(1, 1, key, lambda: now_s)


def heartbeat(end: mavlink.MAVLink, armed: bool = True) -> bytes:
    state = mavlink.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0
    return mavlink.MAVLink_heartbeat_message(2, 3, state, 4, 4, 3).pack(end)


def link() -> VehicleLink:
    found = VehicleLink(sign_key=KEY)
    assert found._signing is not None
    found._signing._now_s = lambda: NOW_S
    found._signing.signing.timestamp = 0
    return found


def test_what_is_signed_with_the_key_is_heard_and_answers_are_signed() -> None:
    one = link()
    one.feed(heartbeat(vehicle()), 5)
    assert one.status.armed
    one.send_velocity(VelocityCommand(1.0, 0.0, 0.0), 0)
    raw = one.take()
    assert raw[2] & mavlink.MAVLINK_IFLAG_SIGNED
    assert hashlib.sha256(KEY + raw[:-6]).digest()[:6] == raw[-6:], "the signature as the MAVLink guide defines it"
    heard = vehicle().parse_buffer(raw)
    assert heard and heard[0].vx == 1.0


@pytest.mark.parametrize("key", [None, OTHER], ids=["unsigned", "another key"])
def test_what_is_not_signed_with_the_key_is_not_heard(key: bytes | None) -> None:
    one = link()
    one.feed(heartbeat(vehicle(key)), 5)
    assert one.status.heartbeat_us is None and not one.status.armed and one.bad_messages == 1


def test_an_unknown_message_is_refused_before_anybody_sees_it() -> None:
    raw = bytearray(heartbeat(vehicle(None)))
    raw[7:10] = b"\xfe\xff\xff"
    assert link().feed(bytes(raw), 5) == []


@pytest.mark.parametrize("at", [10, 14, -14, -13, -7, -1])
def test_one_changed_byte_is_enough(at: int) -> None:
    raw = bytearray(heartbeat(vehicle()))
    raw[at] ^= 1
    one = link()
    one.feed(bytes(raw), 5)
    assert one.status.heartbeat_us is None


def test_a_packet_is_heard_once() -> None:
    one, sender = link(), vehicle()
    armed, disarmed = heartbeat(sender), heartbeat(sender, armed=False)
    one.feed(armed + disarmed, 5)
    assert not one.status.armed
    one.feed(armed, 6)
    assert not one.status.armed and one.status.heartbeat_us == 5, "a recorded packet played again"


def test_a_forged_packet_from_the_future_does_not_silence_the_sender() -> None:
    """pymavlink's own check takes its timestamp before it looks at its signature."""
    one = link()
    one.feed(heartbeat(vehicle()), 4)
    one.feed(heartbeat(vehicle(OTHER, NOW_S + 1e6)), 5)
    one.feed(heartbeat(vehicle(now_s=NOW_S + 1.0)), 6)
    assert one.status.heartbeat_us == 6


@pytest.mark.parametrize(("behind_s", "heard"), [(30.0, True), (NEW_STREAM_TICKS / TICKS_A_SECOND + 5.0, False)])
def test_a_new_sender_may_be_a_minute_behind(behind_s: float, heard: bool) -> None:
    one = link()
    one.feed(heartbeat(vehicle(now_s=NOW_S - behind_s)), 5)
    assert one.status.armed is heard


def test_a_clock_that_is_behind_follows_the_vehicle() -> None:
    one = link()
    one.feed(heartbeat(vehicle(now_s=NOW_S + 1e5)), 5)
    assert one.status.armed
    one.send_heartbeat()
    assert int.from_bytes(one.take()[-12:-6], "little") > (NOW_S + 1e5 - EPOCH_S) * TICKS_A_SECOND - 1


@pytest.mark.parametrize("content", [KEY, KEY.hex().encode(), KEY.hex().upper().encode() + b"\n"])
def test_a_key_file_is_raw_or_hexadecimal(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "key"
    path.write_bytes(content)
    path.chmod(0o600)
    assert load_sign_key(path) == KEY


@pytest.mark.parametrize(("content", "mode", "said"), [
    (b"secret", 0o600, "64 hexadecimal digits"), (KEY, 0o644, "chmod 600"), (None, 0, "openssl rand")])
def test_a_bad_key_file_says_what_to_do(tmp_path: Path, content: bytes | None, mode: int, said: str) -> None:
    path = tmp_path / "key"
    if content is not None:
        path.write_bytes(content)
        path.chmod(mode)
    with pytest.raises(UsageError, match=said):
        load_sign_key(path)


def test_a_time_request_of_the_vehicle_is_answered_in_the_clock_of_the_setpoints() -> None:
    one = VehicleLink()
    ask = mavlink.MAVLink_timesync_message(0, 77)
    one.feed(ask.pack(mavlink.MAVLink(None, srcSystem=2, srcComponent=1)), 5_000)
    assert one.take() == b"", "another system is not answered"
    one.feed(ask.pack(vehicle(None)), 5_000)
    (answer,) = mavlink.MAVLink(None).parse_buffer(one.take())
    assert (answer.tc1, answer.ts1) == (5_000_000, 77)
    one.feed(answer.pack(vehicle(None)), 6_000)
    assert one.take() == b"", "an answer is not answered"
