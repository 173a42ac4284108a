"""What the embedded autopilot refuses, and that it always says why."""

import math

import pytest
from embedded_bench import Bench
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from saranga.errors import DeviceError, UsageError
from saranga.vehicle import MODE_GUIDED
from sitl.autopilot.embedded import EmbeddedAutopilot
from sitl.autopilot.embedded.messages import ekf_flags
from sitl.autopilot.embedded.parameters import DEFINITIONS

ACCEPTED, FAILED, DENIED, UNSUPPORTED = (
    mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_FAILED, mavlink.MAV_RESULT_DENIED,
    mavlink.MAV_RESULT_UNSUPPORTED)


def test_not_ready_at_boot_then_ready_within_five_seconds() -> None:
    bench = Bench()
    bench.run(0.5)
    assert bench.arm() == FAILED
    assert "PreArm: Gyros not calibrated" in bench.texts
    assert ekf_flags(bench.vehicle) == 0
    bench.run(3.0)
    assert not bench.link.status.prearm_ok
    assert bench.arm() == FAILED
    assert "PreArm: AHRS: waiting for home" in bench.texts
    bench.link.send_origin(42.0, -71.0, 100.0)
    bench.run(1.1)
    assert bench.physics.state.t_us < 5_000_000
    assert bench.link.status.prearm_ok and bench.link.status.ekf_flags == 367
    assert bench.arm() == ACCEPTED


@pytest.mark.parametrize(("break_it", "reason"), [
    (lambda b: setattr(b.sensors, "range_enabled", False), "PreArm: Rangefinder 1: No Data"),
    (lambda b: setattr(b.sensors, "flow_enabled", False), "PreArm: Optical flow: not healthy"),
])
def test_arming_is_refused_without_a_sensor(break_it, reason: str) -> None:
    bench = Bench()
    break_it(bench)
    bench.make_ready()
    assert bench.arm() == FAILED
    assert reason in bench.texts
    assert not bench.vehicle.armed and not bench.link.status.prearm_ok
    assert ekf_flags(bench.vehicle) & 128, "held at a constant position"


def test_arming_is_refused_on_a_flat_battery_and_leaning() -> None:
    bench = Bench(charge=0.01)
    bench.make_ready()
    assert bench.arm() == FAILED
    assert any(text.startswith("PreArm: Battery 1 at 13.") and text.endswith("needs 14.0 V") for text in bench.texts)
    leaning = Bench()
    leaning.physics.state.quat[:] = (math.cos(0.3), math.sin(0.3), 0.0, 0.0)
    leaning.vehicle.estimate[0:4] = leaning.physics.state.quat
    assert "Leaning" in _problems(leaning)


def _problems(bench: Bench) -> list[str]:
    from sitl.autopilot.embedded.arming import prearm_problems

    return prearm_problems(bench.vehicle)


def test_the_regular_reminder_says_why_it_cannot_arm() -> None:
    bench = Bench()
    bench.run(31.0)
    assert "PreArm: AHRS: waiting for home" in bench.texts


@pytest.mark.parametrize("mode", [1, 3, 6, 7, 16, 20, 99, 2**31])
def test_unknown_modes_are_refused_by_name(mode: int) -> None:
    bench = Bench()
    bench.make_ready()
    result = bench.command(mavlink.MAV_CMD_DO_SET_MODE, 1, mode)
    assert result == FAILED
    assert any("No such mode" in text for text in bench.texts)
    assert bench.vehicle.mode == 0


def test_guided_needs_a_position() -> None:
    bench = Bench()
    bench.sensors.flow_enabled = False
    bench.make_ready()
    assert bench.command(mavlink.MAV_CMD_DO_SET_MODE, 1, MODE_GUIDED) == FAILED
    assert "Mode change to GUIDED failed: requires position" in bench.texts


def test_legacy_set_mode_message() -> None:
    bench = Bench()
    bench.make_ready()
    bench.send(mavlink.MAVLink_set_mode_message(1, 1, MODE_GUIDED))
    assert bench.vehicle.mode == MODE_GUIDED
    assert bench.link.status.acks[mavlink.MAVLINK_MSG_ID_SET_MODE] == ACCEPTED


def test_stabilize_cannot_be_had_in_the_air() -> None:
    bench = Bench()
    bench.take_off(1.0)
    assert bench.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 0) == FAILED
    assert "Mode change to STABILIZE failed: no radio control" in bench.texts
    bench.run(1.0)
    assert bench.height_m > 0.9


def test_takeoff_is_refused_with_reasons() -> None:
    takeoff = mavlink.MAV_CMD_NAV_TAKEOFF
    bench = Bench()
    bench.make_ready()
    assert bench.command(takeoff, 0, 0, 0, 0, 0, 0, 1.0) == FAILED
    assert "Takeoff refused: mode is STABILIZE, not GUIDED" in bench.texts
    bench.link.send_mode(MODE_GUIDED)
    assert bench.command(takeoff, 0, 0, 0, 0, 0, 0, 1.0) == FAILED
    assert "Takeoff refused: not armed" in bench.texts
    assert bench.arm() == ACCEPTED
    for height in (0.0, -1.0, math.nan, 1e9):
        assert bench.command(takeoff, 0, 0, 0, 0, 0, 0, height) == FAILED
    assert any("not in 0.1 .. 120" in text for text in bench.texts)
    assert bench.vehicle.landed and bench.physics.state.on_ground
    assert bench.command(takeoff, 0, 0, 0, 0, 0, 0, 1.0) == ACCEPTED
    bench.run(4.0)
    assert bench.command(takeoff, 0, 0, 0, 0, 0, 0, 2.0) == FAILED
    assert "Takeoff refused: already flying" in bench.texts


def test_disarming_in_the_air_needs_force() -> None:
    bench = Bench()
    bench.take_off(1.0)
    assert bench.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0) == FAILED
    assert any("in the air" in text for text in bench.texts)
    assert bench.vehicle.armed
    assert bench.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 21196) == ACCEPTED
    assert not bench.vehicle.armed
    bench.run(2.0)
    assert bench.physics.state.on_ground


def test_armed_on_the_ground_disarms_by_itself() -> None:
    bench = Bench(parameters={"DISARM_DELAY": 3.0})
    bench.make_ready()
    assert bench.arm() == ACCEPTED
    took_s = bench.run(6.0, until=lambda: not bench.vehicle.armed)
    assert took_s == pytest.approx(3.0, abs=0.2)


def test_a_command_it_does_not_have_is_answered_unsupported() -> None:
    bench = Bench()
    bench.run(0.1)
    assert bench.command(mavlink.MAV_CMD_DO_PARACHUTE, 1) == UNSUPPORTED
    assert bench.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 7) == DENIED
    assert any("must be 0 or 1" in text for text in bench.texts)
    assert bench.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 9999) == FAILED
    assert bench.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 9999, 100_000) == FAILED


def test_parameters_round_trip_and_refuse_with_reason() -> None:
    bench = Bench()
    bench.send(mavlink.MAVLink_param_request_list_message(1, 1), seconds=2.0)
    listed = {m.param_id: m for m in bench.of("PARAM_VALUE")}
    assert sorted(listed) == sorted(d.name for d in DEFINITIONS)
    assert {m.param_count for m in listed.values()} == {len(DEFINITIONS)}
    assert listed["LAND_SPEED"].param_type == mavlink.MAV_PARAM_TYPE_INT16
    assert listed["GUID_TIMEOUT"].param_type == mavlink.MAV_PARAM_TYPE_REAL32

    def put(name: str, value: float) -> float | None:
        bench.link.status.parameters.pop(name, None)
        bench.send(mavlink.MAVLink_param_set_message(1, 1, name.encode(), value, mavlink.MAV_PARAM_TYPE_REAL32))
        return bench.link.status.parameters.get(name)

    assert put("GUID_TIMEOUT", 1.5) == 1.5
    assert put("LAND_SPEED", 45.4) == 45.0, "integers are kept whole"
    assert put("GUID_TIMEOUT", 99.0) == 1.5
    assert any("GUID_TIMEOUT = 99 must be within 0.1 .. 5" in text for text in bench.texts)
    assert put("GUID_TIMEOUT", math.nan) == 1.5
    assert put("GUID_TIMEOOT", 1.0) is None
    assert any("did you mean GUID_TIMEOUT" in text for text in bench.texts)
    bench.link.request_parameter("GUID_TIMEOUT")
    bench.run(0.1)
    assert bench.link.status.parameters["GUID_TIMEOUT"] == 1.5
    bench.link.request_parameter("NO_SUCH")
    bench.run(0.1)
    assert bench.of("PARAM_ERROR")[-1].error == mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST


def test_bad_parameters_at_construction_are_usage_errors() -> None:
    with pytest.raises(UsageError, match=r"no parameter 'PSC_VELXY_Q', did you mean PSC_VELXY_"):
        EmbeddedAutopilot(parameters={"PSC_VELXY_Q": 1.0})
    with pytest.raises(UsageError, match=r"LAND_SPEED = 5 must be within 30 .. 200"):
        EmbeddedAutopilot(parameters={"LAND_SPEED": 5.0})


def test_says_what_it_is() -> None:
    bench = Bench()
    bench.run(0.1)
    assert any("embedded autopilot" in text for text in bench.texts)
    bench.link.request_message(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    bench.run(0.1)
    assert bench.link.status.firmware_hash == "EMBEDDED"
    assert bench.link.status.autopilot_type == mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    assert bench.link.status.vehicle_type == mavlink.MAV_TYPE_QUADROTOR
    assert "EMBEDDED" in bench.autopilot.version


def test_message_rates_are_those_asked_for() -> None:
    bench = Bench()
    for message_id, rate in ((mavlink.MAVLINK_MSG_ID_ATTITUDE, 10), (mavlink.MAVLINK_MSG_ID_VFR_HUD, 2)):
        bench.link.send_message_interval(message_id, rate)
    bench.run(4.0)
    assert len(bench.of("ATTITUDE")) == pytest.approx(40, abs=2)
    assert len(bench.of("VFR_HUD")) == pytest.approx(8, abs=1)
    assert len(bench.of("HEARTBEAT")) == pytest.approx(4, abs=1)
    bench.link.send_message_interval(mavlink.MAVLINK_MSG_ID_ATTITUDE, 0)
    bench.link.send_message_interval(mavlink.MAVLINK_MSG_ID_HEARTBEAT, 0)
    bench.run(0.5)
    before, beats = len(bench.of("ATTITUDE")), len(bench.of("HEARTBEAT"))
    bench.run(3.0)
    assert len(bench.of("ATTITUDE")) == before
    assert len(bench.of("HEARTBEAT")) == beats + 3, "the heartbeat cannot be switched off"
    bench.send(mavlink.MAVLink_request_data_stream_message(1, 1, mavlink.MAV_DATA_STREAM_ALL, 4, 1))
    seen = len(bench.of("BATTERY_STATUS"))
    bench.run(2.0)
    assert len(bench.of("BATTERY_STATUS")) - seen == pytest.approx(8, abs=1)


def test_other_answers_ground_stations_wait_for() -> None:
    bench = Bench()
    bench.run(0.5)
    bench.send(mavlink.MAVLink_mission_request_list_message(1, 1))
    assert bench.of("MISSION_COUNT")[-1].count == 0
    bench.send(mavlink.MAVLink_timesync_message(0, 12345))
    assert bench.of("TIMESYNC")[-1].ts1 == 12345 and bench.of("TIMESYNC")[-1].tc1 > 0
    bench.send(mavlink.MAVLink_ping_message(7, 42, 0, 0))
    assert bench.of("PING")[-1].seq == 42
    bench.send(mavlink.MAVLink_file_transfer_protocol_message(0, 1, 1, [5, 0, 0, 4, 0] + [0] * 246))
    reply = bench.of("FILE_TRANSFER_PROTOCOL")[-1].payload
    assert reply[0] == 6 and reply[3] == 129 and reply[5] == 4
    assert bench.command(mavlink.MAV_CMD_GET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_HEARTBEAT) == ACCEPTED
    assert bench.of("MESSAGE_INTERVAL")[-1].interval_us == 1_000_000


def test_commands_for_another_system_are_not_ours() -> None:
    bench = Bench()
    bench.make_ready()
    bench.send(mavlink.MAVLink_command_long_message(2, 1, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0))
    assert not bench.vehicle.armed
    assert mavlink.MAV_CMD_COMPONENT_ARM_DISARM not in bench.link.status.acks


def test_killed_it_raises_and_names_the_cause() -> None:
    bench = Bench()
    bench.run(0.1)
    bench.autopilot.kill()
    assert "killed" in (bench.autopilot.health() or "")
    with pytest.raises(DeviceError, match="killed"):
        bench.run(0.1)
    bench.autopilot.close()
    bench.autopilot.close()
