"""Asking a vehicle, in simulated time: the embedded autopilot, clean and with faults planted in it."""

import dataclasses
import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from parked_link import QUICK, ParkedLink, ask, judged, with_rest
from planted import VEHICLE, caught
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from bench.preflight.collect import ARMED, WATCH, Conversation, gather
from bench.preflight.command import _finite
from bench.preflight.evidence import Evidence
from bench.preflight.fix import fix_parameters
from bench.preflight.guard import READ_ONLY_COMMANDS, GuardedLink, harmless
from bench.preflight.mavsdk_bridge import ask_mavsdk
from bench.preflight.parameter_difference import difference, wanted_parameters
from saranga.errors import DeviceError, UsageError
from saranga.navigate import VelocityCommand
from saranga.vehicle import VehicleLink
from sitl.autopilot.frames import FrameReader
from sitl.parked import BOOT_S
from sitl.parked_faults import Disguise, ParkedFaults

EMBEDDED = [planted for planted in VEHICLE if not planted.real_only]


def test_a_clean_embedded_vehicle_is_a_go(embedded, clean):
    result = judged(with_rest(embedded, clean))
    assert result["go"], result["reason"]
    assert embedded.vehicle.origin == "emulated" and len(embedded.vehicle.parameters) > 80


@pytest.mark.parametrize("planted", EMBEDDED, ids=lambda planted: planted.title)
def test_a_planted_fault_is_named(clean, planted):
    evidence, _ = ask(*planted.faults)
    assert caught(judged(with_rest(evidence, clean)), planted) == ""


def test_only_harmless_messages_are_sent():
    _, link = ask()
    sent = FrameReader().feed(link.sent)
    assert len(sent) > 50 and all(harmless(frame) for frame in sent)
    assert {frame.system for frame in sent} == {254}


def test_an_armed_vehicle_stops_everything_at_once():
    evidence, link = ask("says_armed")
    assert evidence.vehicle.stopped == ARMED
    sent = [frame.message_id for frame in FrameReader().feed(link.sent)]
    assert set(sent) <= {mavlink.MAVLINK_MSG_ID_HEARTBEAT} and len(sent) <= 2


def test_another_system_id_is_named():
    evidence, _ = ask("SYSID_THISMAV=9")
    assert "system 9 speaks: give --system" in evidence.absent["vehicle"]
    assert ask("SYSID_THISMAV=9", system=9)[0].vehicle.parameters


def test_message_rates_are_put_back():
    link = ParkedLink()
    schedule = link.vehicle.autopilot.schedule
    before = {message_id: schedule.interval_us(message_id) for message_id in WATCH}
    conversation = Conversation(GuardedLink(link), now=link.now)
    gather(conversation, [], deadlines=QUICK)
    during = {message_id: schedule.interval_us(message_id) for message_id in WATCH}
    conversation.put_rates_back()
    link.read(0.5)
    assert {message_id: schedule.interval_us(message_id) for message_id in WATCH} == before != during
    link.close()


def test_rubbish_is_told_apart_from_silence():
    class Rubbish(ParkedLink):
        def read(self, timeout_s):
            super().read(timeout_s)
            return b"\x55\xaa\x00" * 20

    link = Rubbish()
    with pytest.raises(DeviceError, match=r"no heartbeat in 6 s; \d+ bytes that are no MAVLink"):
        gather(Conversation(GuardedLink(link), now=link.now), [], deadlines=QUICK)


def test_a_link_that_breaks_is_told():
    class Broken(ParkedLink):
        def read(self, timeout_s):
            if self.now() > BOOT_S["embedded"] + 4.0:
                raise DeviceError("simulated: lost: was it unplugged?")
            return super().read(timeout_s)

    link = Broken()
    with pytest.raises(DeviceError, match="unplugged"):
        gather(Conversation(GuardedLink(link), now=link.now), [], deadlines=QUICK)


def test_parameters_that_do_not_come_are_asked_for_by_name():
    link = ParkedLink("drop=0.5")
    conversation = Conversation(GuardedLink(link), now=link.now)
    conversation.connect(10.0)
    conversation.read_parameters(20.0, ["GUID_TIMEOUT", "FS_GCS_ENABLE", "BATT_LOW_VOLT"])
    assert {"GUID_TIMEOUT", "FS_GCS_ENABLE", "BATT_LOW_VOLT"} <= set(conversation.evidence.parameters)
    link.close()


def test_mavsdk_that_cannot_start_is_an_answer(monkeypatch):
    monkeypatch.setattr("bench.preflight.mavsdk_bridge.sys.executable", "/bin/false")
    assert "ended with code 1" in ask_mavsdk(GuardedLink(Sink()), 10.0)["failed"]
    monkeypatch.setattr("bench.preflight.mavsdk_bridge.sys.executable", "/nowhere/python")
    assert "cannot be started" in ask_mavsdk(GuardedLink(Sink()), 10.0)["failed"]


def test_mavsdk_that_takes_too_long_is_cut_off():
    assert ask_mavsdk(GuardedLink(Sink()), 0.3)["failed"] == "MAVSDK was not done in time"


# ---- the guard ---------------------------------------------------------------------------------------
def every_command() -> list[int]:
    return [number for number in mavlink.enums["MAV_CMD"] if 0 < number < 65_536]


class Sink:
    url = "sink:"

    def __init__(self):
        self.data = b""

    def open(self): ...

    def close(self): ...

    def read(self, timeout_s):
        return b""

    def write(self, data):
        self.data += data


def test_of_all_commands_only_the_harmless_pass():
    sink, talk = Sink(), VehicleLink(254, 190)
    guard = GuardedLink(sink)
    for command in every_command():
        talk.send_command(command, 1.0, 21196.0)
        talk.send(mavlink.MAVLink_command_int_message(1, 1, 0, command, 0, 0, 1, 21196, 0, 0, 0, 0, 0))
    guard.write(talk.take())
    passed = FrameReader().feed(sink.data)
    assert len(passed) == len(READ_ONLY_COMMANDS & set(every_command()))
    assert mavlink.MAV_CMD_COMPONENT_ARM_DISARM not in READ_ONLY_COMMANDS
    assert len(guard.dropped) == 2 * len(every_command()) - len(passed)


def test_nothing_that_moves_or_writes_passes():
    sink, talk = Sink(), VehicleLink(254, 190)
    guard = GuardedLink(sink)
    talk.send_velocity(VelocityCommand(1.0, 0.0, 0.0), 0)
    talk.send(mavlink.MAVLink_set_mode_message(1, 1, 4))
    talk.send(mavlink.MAVLink_rc_channels_override_message(1, 1, *[1900] * 8))
    talk.send(mavlink.MAVLink_manual_control_message(1, 0, 0, 1000, 0, 0))
    talk.send(mavlink.MAVLink_param_set_message(1, 1, b"ARMING_CHECK", 0.0, 9))
    talk.send(mavlink.MAVLink_log_erase_message(1, 1))
    guard.write(talk.take())
    assert sink.data == b"" and len(guard.dropped) == 6
    guard.parameters_open = True
    talk.send(mavlink.MAVLink_param_set_message(1, 1, b"ARMING_CHECK", 1.0, 9))
    guard.write(talk.take())
    assert [frame.message_id for frame in FrameReader().feed(sink.data)] == [mavlink.MAVLINK_MSG_ID_PARAM_SET]


# ---- --fix-parameters --------------------------------------------------------------------------------
def talking(*faults: str) -> tuple[Conversation, GuardedLink, ParkedLink]:
    link = ParkedLink(*faults)
    guard = GuardedLink(link)
    conversation = Conversation(guard, now=link.now)
    gather(conversation, [], deadlines=QUICK)
    return conversation, guard, link


def test_parameters_are_written_after_the_word_and_read_back():
    conversation, guard, link = talking("MOT_THST_EXPO=0.3", "GUID_TIMEOUT=5")
    done = fix_parameters(conversation, guard, wanted_parameters(), lambda prompt: "WRITE")
    assert sorted(done.written) == ["GUID_TIMEOUT 5 -> 3", "MOT_THST_EXPO 0.3 -> 0.55"] and not done.failed
    assert link.vehicle.autopilot.parameters["GUID_TIMEOUT"] == 3.0
    assert not difference(conversation.evidence, wanted_parameters()).different
    assert not guard.parameters_open


@pytest.mark.parametrize("answer", ["", "yes", "write", "y"])
def test_nothing_is_written_without_the_word(answer):
    conversation, guard, link = talking("MOT_THST_EXPO=0.3")
    before = len(link.sent)
    done = fix_parameters(conversation, guard, wanted_parameters(), lambda prompt: answer)
    assert not done.agreed and not done.written and len(link.sent) == before


def test_nothing_is_written_where_it_was_armed_while_we_waited():
    conversation, guard, link = talking("MOT_THST_EXPO=0.3")

    def ask_while_it_is_armed(prompt):
        link.vehicle._disguise = Disguise(ParkedFaults(says_armed=True))
        return "WRITE"

    done = fix_parameters(conversation, guard, wanted_parameters(), ask_while_it_is_armed)
    assert not done.written and "armed" in done.failed[0]
    assert not [f for f in FrameReader().feed(link.sent) if f.message_id == mavlink.MAVLINK_MSG_ID_PARAM_SET]


def test_a_refused_value_is_told():
    conversation, guard, link = talking("MOT_THST_EXPO=0.3")
    link.vehicle.autopilot.parameters.set = lambda name, value: "refused"
    done = fix_parameters(conversation, guard, wanted_parameters(), lambda prompt: "WRITE")
    assert done.failed == ["MOT_THST_EXPO: reads 0.3, wanted 0.55"]


def test_without_anybody_to_confirm_it_is_bad_input(monkeypatch):
    import io

    conversation, guard, _ = talking("MOT_THST_EXPO=0.3")
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    with pytest.raises(UsageError, match="somebody who confirms"):
        fix_parameters(conversation, guard, wanted_parameters())


# ---- rubbish -----------------------------------------------------------------------------------------
NUMBERS = st.one_of(st.floats(width=32), st.just(float("nan")))


@st.composite
def messages(draw) -> bytes:
    """Well-formed messages with values that make no sense, from any system, and rubbish between them."""
    mav = mavlink.MAVLink(None, srcSystem=draw(st.sampled_from([1, 1, 1, 7, 255])), srcComponent=1)
    x, y = draw(NUMBERS), draw(NUMBERS)
    small = draw(st.integers(0, 255))
    made = draw(st.sampled_from([
        mavlink.MAVLink_heartbeat_message(small, small, small & 0x7F, 0, small, 3),
        mavlink.MAVLink_param_value_message(draw(st.binary(max_size=16)), x, 9, draw(st.integers(0, 65535)), small),
        mavlink.MAVLink_attitude_message(small, x, y, x, y, x, y),
        mavlink.MAVLink_ekf_status_report_message(small, x, y, x, y, x, y),
        mavlink.MAVLink_optical_flow_message(small, 0, 3, -3, x, y, small, x, y, x),
        mavlink.MAVLink_vibration_message(small, x, y, x, small, small, small),
        mavlink.MAVLink_system_time_message(0, draw(st.integers(0, 2**32 - 1))),
        mavlink.MAVLink_timesync_message(draw(st.integers(-2**63, 2**63 - 1)), draw(st.integers(-2**63, 2**63 - 1))),
        mavlink.MAVLink_statustext_message(small & 7, draw(st.binary(max_size=50)), small, small & 3),
        mavlink.MAVLink_autopilot_version_message(0, draw(st.integers(0, 2**32 - 1)), 0, 0, 0, [small] * 8, [0] * 8,
                                                  [0] * 8, 0, 0, 0),
        mavlink.MAVLink_message_interval_message(small, -small),
    ]))
    return draw(st.binary(max_size=9)) + made.pack(mav)


class Script(Sink):
    """Says what it was given, a piece each time, on a clock that turns while somebody reads."""

    def __init__(self, pieces):
        super().__init__()
        self.pieces, self.t_s = list(pieces), 100.0

    def read(self, timeout_s):
        self.t_s += max(timeout_s, 0.01)
        return self.pieces.pop(0) if self.pieces else b""


@settings(max_examples=40, deadline=None)
@given(st.lists(messages(), max_size=40))
def test_no_input_crashes_it_hangs_it_passes_or_makes_it_send_harm(pieces):
    hello = mavlink.MAVLink_heartbeat_message(2, 3, 81, 0, 3, 3).pack(mavlink.MAVLink(None, 1, 1))
    link = Script([hello, *pieces])
    guard = GuardedLink(link)
    evidence = Evidence(wanted=wanted_parameters())
    evidence.vehicle = gather(Conversation(guard, now=lambda: link.t_s), [], deadlines=QUICK)
    evidence.now_s = link.t_s
    result = judged(evidence)
    assert not result["go"] and not guard.dropped
    json.dumps(result, allow_nan=False)
    json.dumps(_finite(dataclasses.asdict(evidence.vehicle)), allow_nan=False)
