"""Guided setpoints that the embedded autopilot takes, refuses, or outlives; and bytes that are none."""

import math

import numpy as np
import pytest
from embedded_bench import Bench
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl.autopilot.frames import FrameReader

VELOCITY = 0b010111000111


def target(frame: int = 8, mask: int = VELOCITY, vx: float = 1.0, vy: float = 0.0, vz: float = 0.0,
           system: int = 1) -> object:
    return mavlink.MAVLink_set_position_target_local_ned_message(
        0, system, 1, frame, mask, 0, 0, 0, vx, vy, vz, 0, 0, 0, 0, 0)


@pytest.fixture
def flying() -> Bench:
    bench = Bench()
    bench.take_off(1.0)
    return bench


@pytest.mark.parametrize("frame", [1, 8, 9])
def test_velocity_frames_that_arducopter_takes(flying: Bench, frame: int) -> None:
    flying.send(target(frame), seconds=2.0)
    assert flying.physics.state.vel_m_s[0] == pytest.approx(0.95, abs=0.1)


def test_frame_12_is_refused_and_stops_the_vehicle(flying: Bench) -> None:
    flying.run(2.0, (1.0, 0.0, 0.0))
    flying.send(target(12), seconds=2.0)
    assert flying.speed_m_s() < 0.2, "it stopped at once, not after GUID_TIMEOUT"
    assert "Setpoint refused: frame 12 (use 1, 7, 8 or 9)" in flying.texts


@pytest.mark.parametrize(("message", "reason"), [
    (target(vx=math.nan), "not a number"), (target(vy=math.inf), "not a number"), (target(vx=25.0), "speed over 20"),
    (target(mask=0x000F), "sets neither"), (target(mask=0b001000000111 & ~0x1C0), "forces are not supported"),
])
def test_bad_setpoints_stop_the_vehicle_with_a_reason(flying: Bench, message: object, reason: str) -> None:
    flying.run(1.5, (0.8, 0.0, 0.0))
    flying.send(message, seconds=2.0)
    assert flying.speed_m_s() < 0.2
    assert any(text.startswith("Setpoint refused") and reason in text for text in flying.texts)


def test_setpoints_that_cease_are_held_for_guid_timeout_then_it_brakes(flying: Bench) -> None:
    flying.run(2.0, (1.0, 0.0, 0.0))
    flying.run(2.7)
    assert flying.physics.state.vel_m_s[0] == pytest.approx(1.0, abs=0.1), "held for 3 s"
    flying.run(2.0)
    assert flying.speed_m_s() < 0.2
    assert flying.vehicle.armed and flying.height_m > 0.8


def test_guid_timeout_is_the_parameters() -> None:
    bench = Bench(parameters={"GUID_TIMEOUT": 0.5})
    bench.take_off(1.0)
    bench.run(1.5, (1.0, 0.0, 0.0))
    bench.run(2.0)
    assert bench.speed_m_s() < 0.2


def test_setpoints_for_another_system_are_ignored(flying: Bench) -> None:
    flying.send(target(system=7), seconds=1.0)
    assert flying.speed_m_s() < 0.1


def test_setpoints_on_the_ground_do_nothing() -> None:
    bench = Bench()
    bench.make_ready()
    bench.link.send_mode(4)
    bench.run(0.2)
    bench.arm()
    bench.run(2.0, (1.0, 0.0, -1.0))
    assert bench.physics.state.on_ground and bench.speed_m_s() < 1e-3


def test_a_setpoint_before_lift_off_cancels_the_takeoff() -> None:
    bench = Bench()
    bench.make_ready()
    bench.link.send_mode(4)
    bench.run(0.1)
    bench.arm()
    bench.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 1.0)
    bench.run(2.0, (0.0, 0.0, 0.0))
    assert bench.physics.state.on_ground and bench.vehicle.landed
    assert "Takeoff cancelled by a setpoint" in bench.texts


def test_setpoints_are_ignored_outside_guided(flying: Bench) -> None:
    assert flying.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 5) == 0
    flying.run(2.0, (1.0, 0.0, 0.0))
    assert flying.speed_m_s() < 0.1
    assert flying.height_m == pytest.approx(1.0, abs=0.1)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(st.binary(min_size=1, max_size=300), max_size=8))
def test_rubbish_never_raises_and_never_arms(chunks: list[bytes]) -> None:
    bench = RUBBISH
    for chunk in chunks:
        bench.run(0.0025, extra=chunk)
    assert not bench.vehicle.armed
    assert np.all(bench.autopilot._throttle == 0.0)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.sampled_from(sorted(mavlink.mavlink_map)), st.binary(min_size=255, max_size=255))
def test_any_valid_frame_with_any_content_never_raises(message_id: int, content: bytes) -> None:
    """Checksums are right, so every handler sees every kind of nonsense."""
    kind = mavlink.mavlink_map[message_id]
    payload = content[:kind.unpacker.size]
    RUBBISH.run(0.03, extra=_frame(message_id, payload, kind.crc_extra))
    assert np.all(np.isfinite(RUBBISH.autopilot._throttle))
    assert np.all(np.isfinite(RUBBISH.vehicle.estimate[:22]))


def _frame(message_id: int, payload: bytes, extra: int) -> bytes:
    from pymavlink.generator.mavcrc import x25crc

    head = bytes((len(payload), 0, 0, 0, 255, 190)) + message_id.to_bytes(3, "little")
    return b"\xfd" + head + payload + x25crc(head + payload + bytes((extra,))).crc.to_bytes(2, "little")


RUBBISH = Bench()
RUBBISH.run(3.0)


def test_a_cut_and_dirty_stream_loses_only_what_was_dirty() -> None:
    """Against frames made by pymavlink: all but the damaged one come out, whatever the cuts."""
    mav = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    frames = [mavlink.MAVLink_ping_message(i, i, 0, 0).pack(mav) for i in range(50)]
    frames[20] = frames[20][:-3] + bytes((frames[20][-3] ^ 0xFF,)) + frames[20][-2:]
    stream = b"\x00\xfd\x11" + b"".join(frames[:30]) + b"\xfe\xfd garbage" + b"".join(frames[30:])
    rng = np.random.default_rng(5)
    reader, got = FrameReader(), []
    while stream:
        n = int(rng.integers(1, 40))
        got += reader.feed(stream[:n])
        stream = stream[n:]
    got += reader.feed(bytes(300))
    sequence = [reader.decode(f).seq for f in got]
    assert sequence == [i for i in range(50) if i != 20]
    assert reader.rubbish_bytes > 10


def test_version_1_frames_are_read_too() -> None:
    from pymavlink.dialects.v10 import ardupilotmega as old

    mav = old.MAVLink(None, srcSystem=255, srcComponent=190)
    (frame,) = FrameReader().feed(old.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(mav))
    assert (frame.message_id, frame.system, frame.component) == (0, 255, 190)
