"""The companion's vehicle link and the trial's ground station against any bytes: no crash, no foreign orders."""

import time

from hypothesis import given, settings
from hypothesis import strategies as st
from mavlink_strategies import ARM, stream
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from saranga.companion import may_command
from saranga.signing import SigningMavlink
from saranga.vehicle import VehicleLink, VehicleStatus
from sitl.ground_control import Flight, GroundControl, Phase

FOREIGN = st.one_of(st.integers(2, 255), st.just(0))
ANY = st.one_of(st.just(1), st.integers(0, 255))
KEY = bytes(range(32))
FUZZ = settings(max_examples=150, deadline=None)


def sent(data: bytes) -> list[mavlink.MAVLink_message]:
    return mavlink.MAVLink(None).parse_buffer(data) or [] if data else []


@given(stream(ANY))
@FUZZ
def test_the_link_survives_anything_and_asks_for_nothing(data: bytes) -> None:
    link = VehicleLink()
    link.feed(data, 1)
    assert all(m.get_type() == "TIMESYNC" for m in sent(link.take())), "it answers the time, and nothing else"
    assert may_command(link) in (True, False)


@given(stream(FOREIGN))
@FUZZ
def test_a_foreign_system_cannot_command_the_link(data: bytes) -> None:
    link = VehicleLink()
    link.feed(data, 1)
    assert link.status == VehicleStatus() and link.take() == b"" and not may_command(link)


@given(stream(st.just(1), st.integers(2, 255)))
@FUZZ
def test_nor_can_another_component_of_the_vehicle(data: bytes) -> None:
    link = VehicleLink()
    link.feed(data, 1)
    assert link.status == VehicleStatus() and link.take() == b""


@given(stream(st.just(1), st.just(1)))
@FUZZ
def test_with_a_key_nothing_unsigned_is_heard(data: bytes) -> None:
    link = VehicleLink(sign_key=KEY)
    assert link.feed(data, 1) == [] and link.status == VehicleStatus() and link.take() == b""


@given(st.binary(min_size=13, max_size=13), st.integers(0, 2**48 - 1))
@FUZZ
def test_no_guessed_signature_is_heard(signature: bytes, timestamp: int) -> None:
    other = SigningMavlink(1, 1, bytes(32))
    other.signing.timestamp = timestamp
    beat = mavlink.MAVLink_heartbeat_message(2, 3, mavlink.MAV_MODE_FLAG_SAFETY_ARMED, 4, 4, 3).pack(other)
    link = VehicleLink(sign_key=KEY)
    link.feed(beat + beat[:-13] + signature, 1)
    assert link.status == VehicleStatus()


@given(stream(FOREIGN), st.integers(0, 6))
@FUZZ
def test_the_ground_station_flies_for_its_own_vehicle_only(data: bytes, cut: int) -> None:
    ground = GroundControl(Flight(1.0, [], needs_arducopter=False))
    for tick in range(30):
        ground.feed(data[cut:] if tick % 2 else data, tick * 62_500)
        ground.tick(tick * 62_500, 0.0)
        assert not [m for m in sent(ground.take()) if getattr(m, "command", None) in (ARM, 22)]
    assert ground.phase is Phase.START and ground.link.status == VehicleStatus()


@given(stream(ANY, st.just(1)))
@FUZZ
def test_the_ground_station_survives_its_vehicle_gone_mad(data: bytes) -> None:
    ground = GroundControl(Flight(1.0, [], needs_arducopter=True))
    for tick in range(20):
        ground.feed(data, tick * 250_000)
        ground.tick(tick * 250_000, 0.0)
        ground.all_events()
    assert ground.phase in Phase


def test_a_flood_of_false_starts_does_not_hang_the_link() -> None:
    """Every byte begins a frame that is none: what costs most."""
    link = VehicleLink()
    began = time.process_time()
    for byte in (0xFD, 0xFE):
        link.feed(bytes([byte]) * 20_000, 1)
    # About 0.1 s of work here; a parser that looks at the rest again for each byte takes minutes.
    assert time.process_time() - began < 20.0
