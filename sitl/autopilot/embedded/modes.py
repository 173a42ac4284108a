"""Flight modes: what each asks of the controller, take-off, landing detection, and setpoints in GUIDED.

Without a radio control the sticks count as centred: LOITER, ALT_HOLD and BRAKE hold; STABILIZE can only be
had on the ground.
"""

import math
from dataclasses import dataclass

from sitl.autopilot.embedded import layout as at
from sitl.autopilot.embedded.arming import NEEDS_POSITION, disarm
from sitl.autopilot.embedded.shaping import sqrt_controller
from sitl.autopilot.embedded.vehicle import (
    ALT_HOLD,
    BRAKE,
    GUIDED,
    INFO,
    LAND,
    MODE_NAMES,
    STABILIZE,
    WARNING,
    Vehicle,
)

UPDATE_S = 0.02
LAND_DETECT_S = 1.0
LANDED_SPEED_M_S = 0.3
LANDED_ACCEL_M_S2 = 1.5
TAKEOFF_REACHED_M = 0.05
LIFTED_M = 0.05
CEILING_SHORT_M = 0.14
MAX_YAW_RATE_RAD_S = 3.5


@dataclass
class Setpoint:
    """A guided setpoint in the world frame; `velocity` or `position` is None when unused."""

    t_us: int
    velocity: tuple[float, float, float] | None = None
    position: tuple[float, float, float] | None = None
    yaw_rate_rad_s: float = 0.0
    yaw_rad: float | None = None


@dataclass
class Modes:
    """Runs the present mode at 50 Hz."""

    vehicle: Vehicle
    guided: str = "hold"  # hold, takeoff, velocity, position
    setpoint: Setpoint | None = None
    takeoff_height_m: float = 0.0
    _landed_s: float = 0.0
    _idle_s: float = 0.0
    _heading_rad: float | None = None
    _turn_rad_s: float = 0.0

    # ---- requests --------------------------------------------------------------------------------
    def change(self, mode: int, why: str = "") -> str | None:
        """Enter a mode; returns the reason why not, or None."""
        vehicle = self.vehicle
        name = MODE_NAMES.get(mode)
        if name is None:
            known = ", ".join(f"{number} {text}" for number, text in MODE_NAMES.items())
            return f"No such mode {mode}: known are {known}"
        if mode == vehicle.mode:
            return None
        if mode in NEEDS_POSITION and not vehicle.aided:
            return f"Mode change to {name} failed: requires position"
        if mode == BRAKE and not vehicle.aided:
            return f"Mode change to {name} failed: requires position"
        if mode == STABILIZE and vehicle.armed and not vehicle.landed:
            return f"Mode change to {name} failed: no radio control"
        if mode == LAND and not vehicle.estimator_ready:
            return f"Mode change to {name} failed: AHRS not healthy"
        vehicle.mode = mode
        vehicle.landing = mode == LAND
        vehicle.taking_off = False
        vehicle.command[at.RESET] = 1.0
        self._hold()
        if why:
            vehicle.say(INFO, f"{name}: {why}")
        return None

    def takeoff(self, height_m: float) -> str | None:
        """Climb to `height_m` above the place of arming; returns the reason why not, or None."""
        vehicle = self.vehicle
        if vehicle.mode != GUIDED:
            return f"Takeoff refused: mode is {MODE_NAMES[vehicle.mode]}, not GUIDED"
        if not vehicle.armed:
            return "Takeoff refused: not armed"
        if not vehicle.landed:
            return "Takeoff refused: already flying"
        if not math.isfinite(height_m) or not 0.1 <= height_m <= 120.0:
            return f"Takeoff refused: height {height_m:g} m not in 0.1 .. 120"
        self.guided = "takeoff"
        self.takeoff_height_m = height_m
        vehicle.landed = False
        vehicle.taking_off = True
        self._landed_s = 0.0
        return None

    def set_target(self, setpoint: Setpoint) -> None:
        """A valid guided setpoint; ignored on the ground, as ArduCopter does until it has taken off."""
        vehicle = self.vehicle
        if vehicle.mode != GUIDED or not vehicle.armed or vehicle.landed:
            return
        if self.guided == "takeoff" and vehicle.height_m - vehicle.home_height_m < LIFTED_M:
            # In ArduCopter too a setpoint takes the place of a take-off that is under way.
            vehicle.landed = True
            vehicle.taking_off = False
            self._hold()
            vehicle.say(WARNING, "Takeoff cancelled by a setpoint")
            return
        wanted = "velocity" if setpoint.velocity is not None else "position"
        if self.guided != wanted:
            vehicle.command[at.RESET] = 1.0
            vehicle.taking_off = False
        self.guided = wanted
        self.setpoint = setpoint
        self._turn_rad_s = max(min(setpoint.yaw_rate_rad_s, MAX_YAW_RATE_RAD_S), -MAX_YAW_RATE_RAD_S)
        self._heading_rad = setpoint.yaw_rad

    def turn_to(self, heading_rad: float) -> str | None:
        """Hold a heading in GUIDED; returns the reason why not, or None."""
        if self.vehicle.mode != GUIDED:
            return f"Yaw refused: mode is {MODE_NAMES[self.vehicle.mode]}, not GUIDED"
        self._heading_rad = heading_rad
        self._turn_rad_s = 0.0
        return None

    def stop(self) -> None:
        """An invalid setpoint stops the vehicle, as ArduCopter's hold_position does."""
        if self.vehicle.mode == GUIDED and self.guided != "takeoff" and not self.vehicle.landed:
            self._hold()

    def _hold(self) -> None:
        self.guided = "hold"
        self.setpoint = None
        self._turn_rad_s = 0.0
        self._heading_rad = None

    # ---- 50 Hz -----------------------------------------------------------------------------------
    def update(self, dt_s: float) -> None:
        """Write the controller's command for the present mode and state."""
        vehicle = self.vehicle
        command = vehicle.command
        if not vehicle.armed:
            command[at.CONTROL] = at.STOPPED
            self._hold()
            return
        self._detect_landing(dt_s)
        if not vehicle.armed:
            return
        if vehicle.landed:
            command[at.CONTROL] = at.IDLE
            self._idle_s += dt_s
            delay_s = vehicle.parameters["DISARM_DELAY"]
            if vehicle.mode == LAND or (delay_s > 0 and self._idle_s > delay_s):
                disarm(vehicle, forced=False)
            return
        self._idle_s = 0.0
        command[at.CONTROL] = at.FLYING
        command[at.CLIMB_LIMIT] = vehicle.parameters["WPNAV_SPEED_UP"] / 100.0
        velocity, position = (0.0, 0.0, 0.0), None
        if vehicle.mode == GUIDED:
            velocity, position = self._guided()
        elif vehicle.mode == LAND:
            velocity = (0.0, 0.0, vehicle.parameters["LAND_SPEED"] / 100.0)
        self._write(velocity, position)

    def _guided(self) -> tuple[tuple[float, float, float], tuple[float | None, float | None, float] | None]:
        vehicle = self.vehicle
        still = (0.0, 0.0, 0.0)
        if self.guided == "takeoff":
            down = -(self.takeoff_height_m + vehicle.parameters["RNGFND1_GNDCLR"] + vehicle.home_height_m)
            reached = abs(float(vehicle.estimate[at.PD + 2]) - down) < TAKEOFF_REACHED_M
            if reached and vehicle.height_m > 0.5 * self.takeoff_height_m:
                vehicle.taking_off = False
                self._hold()
            return still, (None, None, down)
        setpoint = self.setpoint
        if setpoint is None:
            return still, None
        if setpoint.velocity is not None:
            age_s = (vehicle.t_us - setpoint.t_us) * 1e-6
            if age_s > vehicle.parameters["GUID_TIMEOUT"]:
                self._turn_rad_s = 0.0
                return still, None
            north, east, down = setpoint.velocity
            return (north, east, max(down, -self._climb_allowed_m_s())), None
        return still, setpoint.position

    def _climb_allowed_m_s(self) -> float:
        """ArduPilot keeps a flow-navigating vehicle where the range finder still sees the ground.

        Limit 0.7 RNGFND1_MAX - 1 m (EKF3 getHeightControlLimit), approached as AC_Avoid does; the recorded
        real flight stayed CEILING_SHORT_M below it.
        """
        parameters = self.vehicle.parameters
        room_m = max(0.7 * parameters["RNGFND1_MAX"] - 1.0, 1.0) - CEILING_SHORT_M - self.vehicle.height_m
        if room_m <= 0.0:
            return 0.0
        return sqrt_controller(room_m, parameters["PSC_POSZ_P"], parameters["WPNAV_ACCEL_Z"] / 100.0, UPDATE_S)

    def _write(self, velocity: tuple[float, float, float],
               position: tuple[float | None, float | None, float] | None) -> None:
        vehicle = self.vehicle
        command = vehicle.command
        command[at.COMMAND_V:at.COMMAND_V + 3] = velocity
        command[at.HORIZONTAL] = at.VELOCITY
        command[at.VERTICAL] = at.Z_VELOCITY
        if position is not None:
            north, east, down = position
            command[at.VERTICAL] = at.Z_POSITION
            command[at.COMMAND_P + 2] = down
            if north is not None and east is not None:
                command[at.HORIZONTAL] = at.POSITION
                command[at.COMMAND_P], command[at.COMMAND_P + 1] = north, east
        if not vehicle.aided or vehicle.mode == ALT_HOLD:
            command[at.HORIZONTAL] = at.LEVEL
        if self._heading_rad is not None and vehicle.mode == GUIDED:
            command[at.YAW_MODE], command[at.COMMAND_YAW] = 1.0, self._heading_rad
        else:
            command[at.YAW_MODE], command[at.COMMAND_YAW] = 0.0, self._turn_rad_s

    def _detect_landing(self, dt_s: float) -> None:
        """ArduCopter's detector: least throttle, no acceleration and hardly any speed for one second."""
        vehicle = self.vehicle
        estimate = vehicle.estimate
        if vehicle.landed:
            return
        low = (estimate[at.SPOOL] >= 1.0 and estimate[at.LIMIT_LOW] > 0.0
               and abs(estimate[at.V + 2]) < LANDED_SPEED_M_S and abs(estimate[at.ACCEL_W + 2]) < LANDED_ACCEL_M_S2)
        self._landed_s = self._landed_s + dt_s if low else 0.0
        if self._landed_s >= LAND_DETECT_S:
            vehicle.landed = True
            vehicle.taking_off = False
            self._landed_s = self._idle_s = 0.0
            self._hold()
            vehicle.say(INFO, "Landed")
