"""A motor of a vehicle as the throttle: MAV_CMD_DO_MOTOR_TEST to ArduCopter. It spins only; measure with a stand.

While a motor test runs, ArduCopter's throttle, ground-station and EKF failsafes are off: what stops the motor when
this computer dies is the test's own time-out, which therefore never exceeds 1 s and is refreshed by every command.
Have a hardware kill as well. What the vehicle applies is not read back.

Sources: MAVLink common dialect (MAV_CMD 209); ArduPilot, ArduCopter/motor_test.cpp.
"""

import contextlib
import time
from typing import TYPE_CHECKING, Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from bench.thrust_stand.drivers.teensy import check_command
from bench.thrust_stand.links import DEFAULT_BAUD, byte_link
from bench.thrust_stand.registry import Where
from saranga.byte_links import ByteLink
from saranga.errors import DeviceError

if TYPE_CHECKING:
    from saranga.vehicle import VehicleLink

NAME = "motortest"
FORMS = "motortest+serial:///dev/ttyACM1[?motor=1&baud=115200] or motortest+tcp://127.0.0.1:5760"
MEASURES = False
SPINS = True

LONGEST_TIMEOUT_S = 1.0
HEARTBEAT_TIMEOUT_S = 5.0
OUR_HEARTBEAT_S = 1.0
VEHICLE_SILENT_S = 3.0
GROUND_STATION = 255
REFUSALS = {mavlink.MAV_RESULT_TEMPORARILY_REJECTED: "not now", mavlink.MAV_RESULT_DENIED: "denied",
            mavlink.MAV_RESULT_UNSUPPORTED: "not supported", mavlink.MAV_RESULT_FAILED: "failed"}
MULTIROTORS = (mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_TYPE_HEXAROTOR, mavlink.MAV_TYPE_OCTOROTOR,
               mavlink.MAV_TYPE_TRICOPTER, mavlink.MAV_TYPE_DODECAROTOR)


class MotorTest:
    """ThrottleOutput over a vehicle's MAVLink.

    Args:
        link: the bytes.
        motor: number of the motor in ArduCopter's test order, from 1.
        system: the vehicle's system id.
    """

    readback = False

    def __init__(self, link: ByteLink, motor: int, system: int) -> None:
        self.url = link.url
        self._link = link
        self._motor = motor
        self._system = system
        self._vehicle = self._new_vehicle()
        self._open = False
        self._heartbeat_s = -OUR_HEARTBEAT_S
        self._heard_s = 0.0
        self._spun = False

    def open(self) -> None:
        """Connect and see that a disarmed ArduPilot multirotor is there. Nothing spins.

        Raises:
            DeviceError: no connection, no heartbeat, another vehicle, or an armed one.
        """
        self._link.open()
        self._open, self._spun, self._vehicle = True, False, self._new_vehicle()
        try:
            status = self._vehicle.status
            end_s = time.monotonic() + HEARTBEAT_TIMEOUT_S
            while status.heartbeat_us is None:
                left_s = end_s - time.monotonic()
                if left_s <= 0.0:
                    raise DeviceError(f"{self.url}: no heartbeat of system {self._vehicle.target_system} in"
                                      f" {HEARTBEAT_TIMEOUT_S:g} s: check power, cable, baud rate and SYSID_THISMAV")
                self._pump(min(left_s, 0.2))
            if status.autopilot_type != mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA or status.vehicle_type not in MULTIROTORS:
                raise DeviceError(f"{self.url}: autopilot type {status.autopilot_type}, vehicle type "
                                  f"{status.vehicle_type} is no ArduPilot multirotor: a motor test means something "
                                  "else there, and is refused")
            if status.armed:
                raise DeviceError(f"{self.url}: the vehicle is armed: disarm it; a motor test is for a disarmed "
                                  "vehicle that is tied down")
        except BaseException:
            self._open = False
            self._link.close()
            raise

    def command(self, value: float, token: int, deadline_s: float) -> None:
        """Throttle for at most `deadline_s` (at most 1 s).

        Raises:
            UsageError: a value outside its limits. DeviceError: the vehicle is gone, or has refused a test.
        """
        check_command(value, token, deadline_s, LONGEST_TIMEOUT_S)
        self._opened()
        self._pump(0.0)
        self._check()
        self._spun = self._spun or value > 0.0
        self._test(value, deadline_s if value > 0.0 else 0.0)
        self._flush()

    def applied(self) -> None:
        """Not read back: ArduCopter does not say what its motor test applies."""

    def close(self) -> None:
        """Stop the motor if it was ever used, and let go. Never raises."""
        if not self._open:
            return
        self._open = False
        with contextlib.suppress(DeviceError):  # gone: the test's time-out stops the motor
            if self._spun:
                self._test(0.0, 0.0)
                self._flush()
        self._link.close()

    def _new_vehicle(self) -> "VehicleLink":
        from saranga.vehicle import VehicleLink  # Here: it compiles kernels, which other drivers shall not wait for.

        return VehicleLink(system_id=GROUND_STATION, component_id=mavlink.MAV_COMP_ID_MISSIONPLANNER,
                           target_system=self._system, vehicle_type=mavlink.MAV_TYPE_GCS)

    def _test(self, value: float, timeout_s: float) -> None:
        self._vehicle.send_command(mavlink.MAV_CMD_DO_MOTOR_TEST, float(self._motor),
                                   float(mavlink.MOTOR_TEST_THROTTLE_PERCENT), 100.0 * value, timeout_s, 1.0,
                                   float(mavlink.MOTOR_TEST_ORDER_DEFAULT))

    def _check(self) -> None:
        if time.monotonic() - self._heard_s > VEHICLE_SILENT_S:
            raise DeviceError(f"{self.url}: no word from the vehicle for {VEHICLE_SILENT_S:g} s: check power and cable")

    def _opened(self) -> None:
        if not self._open:
            raise DeviceError(f"{self.url} is not open: open it first")

    def _pump(self, timeout_s: float) -> None:
        """Take in what the vehicle says, send our heartbeat when it is due.

        Raises:
            DeviceError: the link is lost, or the vehicle has refused a motor test.
        """
        now_s = time.monotonic()
        if now_s - self._heartbeat_s >= OUR_HEARTBEAT_S:
            self._heartbeat_s = now_s
            self._vehicle.send_heartbeat()
            self._flush()
        for message in self._vehicle.feed(self._link.read(timeout_s), round(now_s * 1e6)):
            self._heard_s = now_s
            self._on_answer(message)

    def _on_answer(self, message: Any) -> None:
        """Answers to commands of ours; one to another ground station on the same wire is not ours to judge."""
        if message.get_type() != "COMMAND_ACK" or message.command != mavlink.MAV_CMD_DO_MOTOR_TEST:
            return
        if message.result in REFUSALS:
            reason = self._vehicle.status.last_text("motor test", "Motor Test", "PreArm", "check", "safety")
            raise DeviceError(f"{self.url}: the vehicle refuses the motor test ({REFUSALS[message.result]}"
                              f"{': ' + reason if reason else ''}): it must be landed and disarmed, with its safety "
                              "switch off")

    def _flush(self) -> None:
        self._link.write(self._vehicle.take())


def build(where: Where, baud: int = DEFAULT_BAUD, motor: int = 1, system: int = 1) -> MotorTest:
    """The motor behind a URL.

    Args:
        baud: of a serial port; USB ports ignore it.
        motor: in ArduCopter's test order: 1 is front right, then clockwise.
        system: the vehicle's MAVLink system id.

    Raises:
        ValueError: a number outside its limits.
    """
    if not isinstance(motor, int) or not 1 <= motor <= 12:
        raise ValueError(f"motor is {motor!r}: it must be 1..12")
    if not isinstance(system, int) or not 1 <= system <= 255:
        raise ValueError(f"system is {system!r}: it must be 1..255")
    return MotorTest(byte_link(where, baud, FORMS), motor, system)
