"""The MAVLink link: what it believes, what it sends, whom it ignores."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from saranga.navigate import VelocityCommand
from saranga.vehicle import MODE_GUIDED, VehicleLink, version_text


def packed(message: object, system: int = 1, component: int = 1) -> bytes:
    return message.pack(mavlink.MAVLink(None, srcSystem=system, srcComponent=component))  # type: ignore[attr-defined]


def heartbeat(armed: bool = True, mode: int = MODE_GUIDED) -> object:
    base = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (mavlink.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0)
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, base, mode, mavlink.MAV_STATE_ACTIVE, 3)


def test_status_follows_the_vehicle() -> None:
    link = VehicleLink()
    link.feed(packed(heartbeat()), 5)
    assert link.status.armed and link.status.mode_name == "GUIDED" and link.status.heartbeat_us == 5
    link.feed(packed(heartbeat(armed=False, mode=9)), 6)
    assert not link.status.armed and link.status.mode_name == "LAND"


@pytest.mark.parametrize("system,component", [(2, 1), (255, 190), (1, 191)])
def test_a_foreign_sender_cannot_change_the_status(system: int, component: int) -> None:
    link = VehicleLink()
    link.feed(packed(heartbeat(), system, component), 5)
    assert link.status.heartbeat_us is None and not link.status.armed and link.foreign_messages == 1


def test_velocity_goes_out_as_body_frame_setpoint_with_velocity_and_yaw_rate_only() -> None:
    link = VehicleLink()
    link.send_velocity(VelocityCommand(1.0, -0.25, 0.5, 0.1), 2_000_000)
    sent = mavlink.MAVLink(None).parse_buffer(link.take())[0]
    assert (sent.vx, sent.vy, sent.vz) == (1.0, -0.25, 0.5) and sent.yaw_rate == pytest.approx(0.1)
    assert sent.coordinate_frame == 8 and sent.type_mask == 0b010111000111 and sent.time_boot_ms == 2000
    assert link.take() == b""


def test_a_split_message_is_put_together_again() -> None:
    data = packed(heartbeat())
    link = VehicleLink()
    for index in range(len(data)):
        link.feed(data[index : index + 1], index)
    assert link.status.heartbeat_us == len(data) - 1


@given(st.binary(max_size=300))
@settings(max_examples=150, deadline=None)
def test_rubbish_never_raises_and_a_later_message_is_understood(rubbish: bytes) -> None:
    link = VehicleLink()
    link.feed(rubbish, 1)
    # A false start byte may swallow up to one frame's length (280 bytes) of what follows.
    for _ in range(40):
        link.feed(packed(heartbeat()), 2)
    assert link.status.heartbeat_us == 2


@pytest.mark.parametrize("packed_version,text", [
    (0x04070000, "4.7.0-dev"), (0x040507FF, "4.5.7"), (0x040600C0, "4.6.0-rc"), (None, "unknown")])
def test_version_text(packed_version: int | None, text: str) -> None:
    assert version_text(packed_version) == text


def test_velocity_aiding_needs_velocity_and_no_constant_position() -> None:
    link = VehicleLink()
    for flags, expected in ((367, True), (8 | 128, False), (1, False)):
        link.feed(packed(mavlink.MAVLink_ekf_status_report_message(flags, 0, 0, 0, 0, 0)), 1)
        assert link.status.flow_aiding is expected


def test_a_long_text_is_put_together_from_its_chunks_and_a_gap_starts_anew() -> None:
    link = VehicleLink()

    def chunk(text: bytes, number: int, sequence: int) -> None:
        link.feed(packed(mavlink.MAVLink_statustext_message(4, text, number, sequence)), sequence)

    chunk(b"a" * 50, 7, 0)
    chunk(b"b" * 50, 7, 1)
    chunk(b"end", 7, 2)
    chunk(b"another", 0, 0)
    chunk(b"lost its beginning", 8, 1)
    assert [t for _, _, t in link.status.texts] == ["a" * 50 + "b" * 50 + "end", "another", "lost its beginning"]
