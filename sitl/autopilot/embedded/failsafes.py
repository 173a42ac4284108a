"""What ends a flight early: estimate lost, ground station lost, battery low, crash. Landing is the answer."""

from dataclasses import dataclass

from sitl.autopilot.embedded import layout as at
from sitl.autopilot.embedded.arming import disarm
from sitl.autopilot.embedded.modes import Modes
from sitl.autopilot.embedded.vehicle import ALERT, CRITICAL, EMERGENCY, LAND, STABILIZE, WARNING, Vehicle

# ArduCopter: the EKF check runs at 10 Hz and acts after ten bad results.
ESTIMATE_PATIENCE_S = 1.0
CRASH_ANGLE_RAD = 0.5236
CRASH_PATIENCE_S = 2.0


@dataclass
class Failsafes:
    """Runs at 50 Hz. `vehicle.failsafe` names the one that acted last and still holds."""

    vehicle: Vehicle
    modes: Modes
    gcs_heard_us: int | None = None
    _estimate_s: float = 0.0
    _crash_s: float = 0.0
    _low_s: float = 0.0
    _critical_s: float = 0.0
    _low_done: bool = False
    _critical_done: bool = False

    def update(self, dt_s: float) -> None:
        vehicle = self.vehicle
        self._ground_station()
        if not vehicle.armed:
            self._estimate_s = self._crash_s = 0.0
            if vehicle.failsafe == "EKF" and vehicle.aided:
                vehicle.failsafe = ""
            return
        self._estimate(dt_s)
        self._battery(dt_s)
        self._crash(dt_s)

    def _act(self, name: str, severity: int, text: str) -> None:
        vehicle = self.vehicle
        vehicle.failsafe = name
        vehicle.say(severity, text)
        if vehicle.landed:
            disarm(vehicle, forced=False)
        elif vehicle.mode != LAND:
            self.modes.change(LAND, f"{name} failsafe")

    def _estimate(self, dt_s: float) -> None:
        vehicle = self.vehicle
        if vehicle.aided or vehicle.mode == STABILIZE:
            if vehicle.failsafe == "EKF":
                vehicle.failsafe = ""
                vehicle.say(WARNING, "EKF Failsafe Cleared")
            self._estimate_s = 0.0
            return
        self._estimate_s += dt_s
        if self._estimate_s >= ESTIMATE_PATIENCE_S and vehicle.failsafe != "EKF":
            vehicle.say(CRITICAL, "EKF variance")
            if vehicle.parameters["FS_EKF_ACTION"] > 0:
                self._act("EKF", CRITICAL, "EKF Failsafe: changed to LAND Mode")

    def _ground_station(self) -> None:
        vehicle = self.vehicle
        heard = self.gcs_heard_us
        if heard is None or vehicle.parameters["FS_GCS_ENABLE"] == 0:
            return
        lost = vehicle.t_us - heard > vehicle.parameters["FS_GCS_TIMEOUT"] * 1e6
        if vehicle.failsafe == "GCS" and not lost:
            vehicle.failsafe = ""
            vehicle.say(WARNING, "GCS Failsafe Cleared")
        elif lost and vehicle.armed and vehicle.failsafe == "":
            self._act("GCS", WARNING, "GCS Failsafe")

    def _battery(self, dt_s: float) -> None:
        vehicle, parameters = self.vehicle, self.vehicle.parameters
        volts = vehicle.voltage_v

        def below(name: str, seconds: float) -> float:
            return seconds + dt_s if 0.0 < volts < parameters[name] else 0.0

        self._low_s = below("BATT_LOW_VOLT", self._low_s)
        self._critical_s = below("BATT_CRT_VOLT", self._critical_s)
        patience_s = parameters["BATT_LOW_TIMER"]
        used = f"{volts:.2f}V used {vehicle.used_mah:.0f} mAh"
        if self._low_s > patience_s and not self._low_done:
            self._low_done = True
            vehicle.say(WARNING, f"Battery 1 is low {used}")
            if parameters["BATT_FS_LOW_ACT"] > 0:
                self._act("Battery", ALERT, "Battery Failsafe")
        if self._critical_s > patience_s and not self._critical_done:
            self._critical_done = True
            vehicle.say(CRITICAL, f"Battery 1 is critical {used}")
            if parameters["BATT_FS_CRT_ACT"] > 0:
                self._act("Battery", ALERT, "Battery Failsafe: critical")

    def _crash(self, dt_s: float) -> None:
        vehicle = self.vehicle
        error = float(vehicle.estimate[at.ANGLE_ERROR])
        lost = not vehicle.landed and error > CRASH_ANGLE_RAD and vehicle.parameters["FS_CRASH_CHECK"] > 0
        self._crash_s = self._crash_s + dt_s if lost else 0.0
        if self._crash_s >= CRASH_PATIENCE_S:
            vehicle.say(EMERGENCY, f"Crash: Disarming: AngErr={error * 57.29578:.0f}>30")
            disarm(vehicle, forced=True)
            self._crash_s = 0.0
