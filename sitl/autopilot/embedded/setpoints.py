"""Guided setpoints and MAVLink sensors: the messages that come often, read without building objects."""

import math
import struct
from dataclasses import dataclass

from sitl.autopilot.embedded import layout as at
from sitl.autopilot.embedded.modes import Setpoint
from sitl.autopilot.embedded.vehicle import GUIDED, WARNING, Vehicle

LOCAL_NED, LOCAL_OFFSET_NED, BODY_NED, BODY_OFFSET_NED = 1, 7, 8, 9
_TARGET = struct.Struct("<IfffffffffffHBBB")
_FLOW = struct.Struct("<QfffhhBBff")
_RANGE = struct.Struct("<IHHHBBBBff4fB")
DOWNWARD = 25
MIN_FLOW_QUALITY = 10
IGNORE_POSITION, IGNORE_VELOCITY, IGNORE_ACCELERATION = 0x007, 0x038, 0x1C0
FORCE, IGNORE_YAW, IGNORE_YAW_RATE = 0x200, 0x400, 0x800
MAX_SPEED_M_S = 20.0


@dataclass(frozen=True)
class Refusal:
    """Why a setpoint was not taken."""

    reason: str


def target_systems(payload: bytes) -> tuple[int, int]:
    """Target system and component of SET_POSITION_TARGET_LOCAL_NED."""
    return payload[50], payload[51]


def read_local(vehicle: Vehicle, payload: bytes) -> Setpoint | Refusal:
    """SET_POSITION_TARGET_LOCAL_NED into world axes, turned with the heading at its arrival, as ArduCopter does."""
    (_, x, y, z, vx, vy, vz, _, _, _, yaw, yaw_rate, mask, _, _, frame) = _TARGET.unpack(payload)
    if frame not in (LOCAL_NED, LOCAL_OFFSET_NED, BODY_NED, BODY_OFFSET_NED):
        return Refusal(f"frame {frame} (use 1, 7, 8 or 9)")
    position = (mask & IGNORE_POSITION) == 0
    velocity = (mask & IGNORE_VELOCITY) == 0
    problem = _mask_problem(mask, position, velocity)
    if problem is not None:
        return problem
    turned = frame in (BODY_NED, BODY_OFFSET_NED)
    heading = vehicle.attitude_rad[2]
    used = [*((x, y, z) if position else ()), *((vx, vy, vz) if velocity else ())]
    used += [yaw] if not mask & IGNORE_YAW else []
    used += [yaw_rate] if not mask & IGNORE_YAW_RATE else []
    if not all(map(math.isfinite, used)):
        return Refusal("a value is not a number")
    if velocity and max(abs(vx), abs(vy), abs(vz)) > MAX_SPEED_M_S:
        return Refusal(f"speed over {MAX_SPEED_M_S:g} m/s")
    rate = 0.0 if mask & IGNORE_YAW_RATE else yaw_rate
    wanted_yaw = None if mask & IGNORE_YAW else (yaw + heading if turned else yaw)
    if position:
        north, east, down = _turn(x, y, z, heading) if turned else (x, y, z)
        if frame in (LOCAL_OFFSET_NED, BODY_OFFSET_NED, BODY_NED):
            here = vehicle.position_m
            north, east, down = north + here[0], east + here[1], down + here[2]
        clearance = vehicle.parameters["RNGFND1_GNDCLR"]
        return Setpoint(vehicle.t_us, position=(north, east, min(down, 0.0) - clearance), yaw_rate_rad_s=rate,
                        yaw_rad=wanted_yaw)
    return Setpoint(vehicle.t_us, velocity=_turn(vx, vy, vz, heading) if turned else (vx, vy, vz),
                    yaw_rate_rad_s=rate, yaw_rad=wanted_yaw)


def _mask_problem(mask: int, position: bool, velocity: bool) -> Refusal | None:
    if mask & FORCE and mask & IGNORE_ACCELERATION != IGNORE_ACCELERATION:
        return Refusal("forces are not supported")
    if not position and not velocity:
        return Refusal(f"type mask {mask:#x} sets neither position nor velocity whole")
    return None


def _turn(x: float, y: float, z: float, heading: float) -> tuple[float, float, float]:
    c, s = math.cos(heading), math.sin(heading)
    return c * x - s * y, s * x + c * y, z


def read_flow(vehicle: Vehicle, payload: bytes, interval_s: float) -> None:
    """OPTICAL_FLOW: the rate is flow_x, flow_y (int16) times the interval, as ArduPilot's MAVLink driver has it."""
    if vehicle.parameters["FLOW_TYPE"] != 5 or not 0.0 < interval_s < 0.5:
        return
    _, _, _, _, flow_x, flow_y, _, quality, _, _ = _FLOW.unpack(payload)
    vehicle.flow_quality = quality
    vehicle.flow_rate_rad_s = flow_x * interval_s, flow_y * interval_s
    if quality < MIN_FLOW_QUALITY:
        return
    command = vehicle.command
    command[at.NEW_FLOW] = 1.0
    command[at.FLOW_X], command[at.FLOW_Y] = flow_x * interval_s, flow_y * interval_s


def read_range(vehicle: Vehicle, payload: bytes) -> None:
    """DISTANCE_SENSOR facing down, when within the limits of both sensor and parameters."""
    parameters = vehicle.parameters
    _, least_cm, most_cm, distance_cm, _, _, orientation, *_ = _RANGE.unpack(payload)
    if parameters["RNGFND1_TYPE"] != 10 or orientation != DOWNWARD:
        return
    distance_m = distance_cm * 0.01
    inside = max(least_cm * 0.01, parameters["RNGFND1_MIN"]) - 1e-6 <= distance_m
    if inside and distance_m <= min(most_cm * 0.01, parameters["RNGFND1_MAX"]) + 1e-6:
        vehicle.command[at.NEW_RANGE] = 1.0
        vehicle.command[at.RANGE_M] = distance_m


def refuse(vehicle: Vehicle, refusal: Refusal) -> None:
    """Say why a setpoint was not taken, where it would have had an effect."""
    if vehicle.mode == GUIDED and vehicle.armed:
        vehicle.say(WARNING, f"Setpoint refused: {refusal.reason}")
