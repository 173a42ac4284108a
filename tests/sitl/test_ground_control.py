"""The flight sequence: every wait has a deadline, and its cause names what was awaited."""

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl.autopilot.parameters import Parameter
from sitl.ground_control import DEADLINE_S, Flight, GroundControl, Phase

TICK_US = 62_500
GUIDED, LAND = 4, 9


class Vehicle:
    """Answers as a well-behaved autopilot, except where told otherwise."""

    def __init__(self, vehicle_type: int = mavlink.MAV_TYPE_QUADROTOR, ready: bool = True) -> None:
        self.mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        self.parser = mavlink.MAVLink(None)
        self.vehicle_type, self.ready = vehicle_type, ready
        self.armed, self.mode, self.height_m = False, 0, 0.0
        self.parameters = {"FLOW_TYPE": 5.0}
        self.landing = False

    def answer(self, data: bytes) -> bytes:
        out = b""
        for message in self.parser.parse_buffer(data) or []:
            kind = message.get_type()
            if kind == "PARAM_REQUEST_READ" and message.param_id in self.parameters:
                out += self.pack(mavlink.MAVLink_param_value_message(
                    message.param_id.encode(), self.parameters[message.param_id], 9, 1, 0))
            elif kind == "COMMAND_LONG":
                out += self.command(message)
        state = (mavlink.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0) | 1
        health = mavlink.MAV_SYS_STATUS_PREARM_CHECK if self.ready else 0
        out += self.pack(mavlink.MAVLink_heartbeat_message(self.vehicle_type, 3, state, self.mode, 4, 3))
        out += self.pack(mavlink.MAVLink_sys_status_message(0, 0, health, 0, 16000, 0, 90, 0, 0, 0, 0, 0, 0))
        out += self.pack(mavlink.MAVLink_ekf_status_report_message(367, 0, 0, 0, 0, 0))
        return out

    def pack(self, message: object) -> bytes:
        return message.pack(self.mav)  # type: ignore[attr-defined]

    def command(self, message: object) -> bytes:
        command, p1, p2 = message.command, message.param1, message.param2  # type: ignore[attr-defined]
        if command == mavlink.MAV_CMD_DO_SET_MODE:
            self.mode = int(p2)
            self.landing = self.mode == LAND
        elif command == mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
            self.armed = bool(p1)
        elif command == mavlink.MAV_CMD_NAV_TAKEOFF:
            self.height_m = message.param7  # type: ignore[attr-defined]
        elif command == mavlink.MAV_CMD_REQUEST_MESSAGE:
            return self.pack(mavlink.MAVLink_autopilot_version_message(
                0, 0x04070000, 0, 0, 0, b"abcdefgh", b"0" * 8, b"0" * 8, 0, 0, 0))
        return self.pack(mavlink.MAVLink_command_ack_message(command, 0))


def run(vehicle: Vehicle | None, seconds: float, ground: GroundControl | None = None) -> GroundControl:
    ground = ground or GroundControl(Flight(1.0, [Parameter("FLOW_TYPE", 5.0, "flow", "FLOW_TYPE", 5.0)], True))
    for tick in range(int(seconds * 1e6 / TICK_US)):
        t_us = tick * TICK_US
        data = ground.take()
        if vehicle is not None:
            ground.feed(vehicle.answer(data), t_us)
        ground.tick(t_us, vehicle.height_m if vehicle else 0.0)
        if ground.phase is Phase.COURSE and t_us > 12_000_000:
            ground.land(t_us)
        if vehicle is not None and vehicle.landing:
            vehicle.armed = False
        if ground.phase in (Phase.DONE, Phase.FAILED):
            break
    return ground


def test_a_good_vehicle_is_taken_from_start_to_landed() -> None:
    ground = run(Vehicle(), 40.0)
    assert ground.phase is Phase.DONE and ground.cause is None
    assert [text for _, text in ground.events if text.startswith("phase")] == [
        "phase ready", "phase takeoff", "phase course", "phase land", "phase done"]
    assert any("1 parameters read back" in text for _, text in ground.events)


def test_silence_fails_after_its_deadline_naming_the_heartbeat() -> None:
    ground = run(None, DEADLINE_S[Phase.START] + 1)
    assert ground.phase is Phase.FAILED and "no heartbeat" in (ground.cause or "")


def test_another_vehicle_type_is_wrong_firmware() -> None:
    ground = run(Vehicle(vehicle_type=mavlink.MAV_TYPE_FIXED_WING), 5.0)
    assert ground.phase is Phase.FAILED
    assert "wrong firmware" in (ground.cause or "") and "FIXED_WING" in (ground.cause or "")


@pytest.mark.parametrize("parameters,expected", [({"FLOW_TYPE": 0.0}, "reads 0, wanted 5"), ({}, "no answer")])
def test_a_parameter_that_did_not_take_fails_before_arming(parameters: dict[str, float], expected: str) -> None:
    vehicle = Vehicle()
    vehicle.parameters = parameters
    ground = run(vehicle, 20.0)
    assert ground.phase is Phase.FAILED and expected in (ground.cause or "") and not vehicle.armed


def test_never_ready_is_named_and_never_armed() -> None:
    vehicle = Vehicle(ready=False)
    ground = run(vehicle, 80.0)
    assert ground.phase is Phase.FAILED and "prearm refused" in (ground.cause or "") and not vehicle.armed


def test_leaving_guided_on_the_course_ends_the_flight_with_the_vehicles_reason() -> None:
    class Failsafe(Vehicle):
        def answer(self, data: bytes) -> bytes:
            out = super().answer(data)
            if self.height_m and self.mode == GUIDED:
                self.ticks = getattr(self, "ticks", 0) + 1
                if self.ticks > 40:
                    self.mode = LAND
                    out += self.pack(mavlink.MAVLink_statustext_message(2, b"EKF Failsafe: changed to Land Mode"))
            return out

    ground = run(Failsafe(), 40.0)
    assert ground.phase is Phase.FAILED and "EKF Failsafe" in (ground.cause or "")
