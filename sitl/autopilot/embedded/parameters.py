"""The embedded autopilot's parameters: ArduCopter's names and units where it has one, each with its effect.

Everything that shapes the response to a setpoint is here and nowhere else, so that calibrating against the
real autopilot is a matter of these values. Names starting with EMB_ are its own.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from saranga.errors import UsageError

REAL = mavlink.MAV_PARAM_TYPE_REAL32
INT8, INT16, INT32 = mavlink.MAV_PARAM_TYPE_INT8, mavlink.MAV_PARAM_TYPE_INT16, mavlink.MAV_PARAM_TYPE_INT32


@dataclass(frozen=True)
class Definition:
    """One parameter: default, limits, MAVLink type and what it does."""

    name: str
    default: float
    low: float
    high: float
    kind: int
    effect: str


DEFINITIONS = (
    # Response to horizontal setpoints.
    Definition("WPNAV_ACCEL", 500.0, 50.0, 980.0, REAL, "cm/s^2, horizontal acceleration limit"),
    Definition("WPNAV_SPEED", 1000.0, 10.0, 2000.0, REAL, "cm/s, speed limit towards a position"),
    Definition("PSC_JERK_XY", 15.0, 1.0, 50.0, REAL, "m/s^3, horizontal jerk limit"),
    Definition("PSC_POSXY_P", 1.0, 0.0, 5.0, REAL, "1/s"),
    Definition("PSC_VELXY_P", 4.0, 0.1, 10.0, REAL, "1/s"),
    Definition("PSC_VELXY_I", 1.0, 0.0, 5.0, REAL, "1/s^2"),
    Definition("PSC_VELXY_D", 0.25, 0.0, 2.0, REAL, "velocity error derivative to acceleration"),
    Definition("PSC_VELXY_FLTE", 15.0, 0.5, 100.0, REAL, "Hz, low-pass of the velocity error"),
    Definition("PSC_VELXY_FLTD", 15.0, 0.5, 100.0, REAL, "Hz, low-pass of its derivative"),
    Definition("PSC_VELXY_IMAX", 1000.0, 0.0, 4500.0, REAL, "cm/s^2, integrator limit"),
    # Vertical.
    Definition("WPNAV_SPEED_UP", 250.0, 10.0, 1000.0, REAL, "cm/s, climb limit"),
    Definition("WPNAV_SPEED_DN", 150.0, 10.0, 500.0, REAL, "cm/s, descent limit"),
    Definition("WPNAV_ACCEL_Z", 100.0, 50.0, 500.0, REAL, "cm/s^2, vertical acceleration limit"),
    Definition("PSC_JERK_Z", 5.0, 1.0, 50.0, REAL, "m/s^3, vertical jerk limit"),
    Definition("PSC_POSZ_P", 1.0, 0.0, 5.0, REAL, "1/s"),
    Definition("PSC_VELZ_P", 5.0, 0.1, 20.0, REAL, "1/s"),
    Definition("PSC_ACCZ_P", 0.5, 0.05, 2.0, REAL, "per mille thrust per cm/s^2"),
    Definition("PSC_ACCZ_I", 1.0, 0.0, 4.0, REAL, "per mille thrust per cm/s^3"),
    Definition("PSC_ACCZ_FLTE", 20.0, 1.0, 100.0, REAL, "Hz, low-pass of the vertical acceleration error"),
    # Attitude.
    Definition("ANGLE_MAX", 3000.0, 1000.0, 8000.0, INT16, "centidegrees, lean limit"),
    Definition("ATC_INPUT_TC", 0.15, 0.0, 1.0, REAL, "s, attitude input time constant"),
    Definition("ATC_ANG_RLL_P", 4.5, 1.0, 20.0, REAL, "1/s"),
    Definition("ATC_ANG_PIT_P", 4.5, 1.0, 20.0, REAL, "1/s"),
    Definition("ATC_ANG_YAW_P", 4.5, 1.0, 20.0, REAL, "1/s"),
    Definition("ATC_ACCEL_R_MAX", 110000.0, 1000.0, 500000.0, REAL, "centidegrees/s^2"),
    Definition("ATC_ACCEL_P_MAX", 110000.0, 1000.0, 500000.0, REAL, "centidegrees/s^2"),
    Definition("ATC_ACCEL_Y_MAX", 27000.0, 1000.0, 200000.0, REAL, "centidegrees/s^2"),
    Definition("ATC_RAT_RLL_P", 0.05, 0.001, 1.0, REAL, "thrust fraction per rad/s"),
    Definition("ATC_RAT_RLL_I", 0.05, 0.0, 2.0, REAL, "thrust fraction per rad"),
    Definition("ATC_RAT_RLL_D", 0.0012, 0.0, 0.05, REAL, "thrust fraction per rad/s^2"),
    Definition("ATC_RAT_PIT_P", 0.05, 0.001, 1.0, REAL, "thrust fraction per rad/s"),
    Definition("ATC_RAT_PIT_I", 0.05, 0.0, 2.0, REAL, "thrust fraction per rad"),
    Definition("ATC_RAT_PIT_D", 0.0012, 0.0, 0.05, REAL, "thrust fraction per rad/s^2"),
    Definition("ATC_RAT_YAW_P", 0.15, 0.001, 2.5, REAL, "thrust fraction per rad/s"),
    Definition("ATC_RAT_YAW_I", 0.015, 0.0, 1.0, REAL, "thrust fraction per rad"),
    Definition("ATC_RAT_RLL_FLTT", 20.0, 1.0, 200.0, REAL, "Hz, low-pass of the rate targets"),
    Definition("ATC_RAT_RLL_FLTD", 20.0, 1.0, 200.0, REAL, "Hz, low-pass of the rate derivative"),
    Definition("INS_GYRO_FILTER", 60.0, 5.0, 256.0, INT16, "Hz, low-pass of the gyros"),
    # Motors.
    Definition("MOT_THST_EXPO", 0.55, 0.0, 1.0, REAL, "thrust curve, see the airframe"),
    Definition("MOT_THST_HOVER", 0.30, 0.125, 0.6875, REAL, "thrust fraction at hover"),
    Definition("MOT_SPIN_ARM", 0.10, 0.0, 0.3, REAL, "motor output while idling on the ground"),
    Definition("MOT_SPIN_MIN", 0.15, 0.0, 0.3, REAL, "motor output for no thrust in flight"),
    Definition("MOT_SPIN_MAX", 0.95, 0.6, 1.0, REAL, "motor output for full thrust"),
    Definition("MOT_SPOOL_TIME", 0.5, 0.05, 2.0, REAL, "s from idling to free thrust"),
    # Estimator.
    Definition("EMB_KV", 3.0, 0.1, 20.0, REAL, "1/s, flow innovation to velocity"),
    Definition("EMB_KT", 1.5, 0.0, 20.0, REAL, "1/s^2, flow innovation to tilt, as acceleration"),
    Definition("EMB_KB", 0.10, 0.0, 5.0, REAL, "1/s^3, flow innovation to gyro bias, as acceleration rate"),
    Definition("EMB_KZ", 5.0, 0.1, 20.0, REAL, "1/s, height innovation to height"),
    Definition("EMB_KVZ", 6.0, 0.0, 50.0, REAL, "1/s^2, height innovation to climb rate"),
    Definition("EMB_KBZ", 1.0, 0.0, 20.0, REAL, "1/s^3, height innovation to accelerometer bias"),
    Definition("EMB_KYAW", 0.5, 0.0, 5.0, REAL, "1/s, compass innovation to heading"),
    Definition("EMB_CMD_DELAY", 7.5, 0.0, 200.0, REAL, "ms from a setpoint's arrival to its effect"),
    Definition("FLOW_TYPE", 5.0, 0.0, 5.0, INT8, "0 none, 5 MAVLink OPTICAL_FLOW"),
    Definition("RNGFND1_TYPE", 10.0, 0.0, 10.0, INT8, "0 none, 10 MAVLink DISTANCE_SENSOR"),
    Definition("RNGFND1_MIN", 0.02, 0.0, 1.0, REAL, "m, shortest range used"),
    Definition("RNGFND1_MAX", 5.0, 0.1, 50.0, REAL, "m, longest range used"),
    Definition("RNGFND1_GNDCLR", 0.03, 0.005, 0.5, REAL, "m, range on the ground"),
    Definition("AHRS_ORIG_LAT", 0.0, -90.0, 90.0, REAL, "deg, origin when nobody sets one (0 = wait for one)"),
    Definition("AHRS_ORIG_LON", 0.0, -180.0, 180.0, REAL, "deg, likewise"),
    Definition("AHRS_ORIG_ALT", 0.0, -500.0, 9000.0, REAL, "m, likewise"),
    # What it cannot do otherwise, under ArduCopter's names: only these values are taken.
    Definition("EK3_SRC1_POSXY", 0.0, 0.0, 0.0, INT8, "no horizontal position source"),
    Definition("EK3_SRC1_VELXY", 5.0, 5.0, 5.0, INT8, "velocity from optical flow"),
    Definition("EK3_SRC1_POSZ", 1.0, 1.0, 1.0, INT8, "height as ArduCopter's fixture has it"),
    Definition("EK3_SRC1_YAW", 1.0, 1.0, 1.0, INT8, "heading from the compass"),
    Definition("COMPASS_ENABLE", 1.0, 1.0, 1.0, INT8, "it has a compass"),
    Definition("COMPASS_USE", 1.0, 1.0, 1.0, INT8, "and uses it"),
    Definition("BATT_MONITOR", 4.0, 4.0, 4.0, INT8, "voltage and current of the physics"),
    Definition("LOG_BACKEND_TYPE", 0.0, 0.0, 0.0, INT8, "it keeps no log"),
    Definition("FLTMODE_GCSBLOCK", 0.0, 0.0, 0.0, INT32, "no mode is closed to ground stations"),
    # Behaviour.
    Definition("GUID_TIMEOUT", 3.0, 0.1, 5.0, REAL, "s without a setpoint before the vehicle brakes"),
    Definition("LAND_SPEED", 40.0, 30.0, 200.0, INT16, "cm/s"),
    Definition("DISARM_DELAY", 10.0, 0.0, 127.0, INT8, "s armed on the ground before it disarms (0 = never)"),
    Definition("ARMING_CHECK", 1.0, 0.0, 1.0, INT32, "0 skips the checks that are not mandatory"),
    Definition("FS_GCS_ENABLE", 5.0, 0.0, 5.0, INT8, "0 nothing, else land when the ground station is lost"),
    Definition("FS_GCS_TIMEOUT", 5.0, 2.0, 120.0, REAL, "s without its heartbeat"),
    Definition("FS_EKF_ACTION", 1.0, 0.0, 3.0, INT8, "0 report only, else land when the estimate is lost"),
    Definition("FS_CRASH_CHECK", 1.0, 0.0, 1.0, INT8, "disarm when the attitude stays lost for 2 s"),
    Definition("BATT_LOW_VOLT", 14.0, 0.0, 60.0, REAL, "V, 0 = off"),
    Definition("BATT_CRT_VOLT", 12.8, 0.0, 60.0, REAL, "V, 0 = off"),
    Definition("BATT_LOW_TIMER", 10.0, 0.0, 120.0, INT8, "s below before it counts"),
    Definition("BATT_FS_LOW_ACT", 1.0, 0.0, 1.0, INT8, "0 nothing, 1 land"),
    Definition("BATT_FS_CRT_ACT", 1.0, 0.0, 1.0, INT8, "0 nothing, 1 land"),
    Definition("BATT_ARM_VOLT", 14.0, 0.0, 60.0, REAL, "V, lowest to arm with"),
    Definition("BATT_CAPACITY", 850.0, 0.0, 1e6, INT32, "mAh"),
    Definition("SYSID_THISMAV", 1.0, 1.0, 255.0, INT16, "own MAVLink system id, from the next start on"),
    Definition("SYSID_MYGCS", 255.0, 1.0, 255.0, INT16, "system whose heartbeat is the ground station's"),
)
BY_NAME = {d.name: d for d in DEFINITIONS}
INDEX = {d.name: i for i, d in enumerate(DEFINITIONS)}

# What the compiled loop reads: (parameter, factor to SI), in order; `gain_index` finds them.
GAINS = (
    ("WPNAV_ACCEL", 0.01), ("WPNAV_SPEED", 0.01), ("PSC_JERK_XY", 1.0), ("PSC_POSXY_P", 1.0),
    ("PSC_VELXY_P", 1.0), ("PSC_VELXY_I", 1.0), ("PSC_VELXY_D", 1.0), ("PSC_VELXY_FLTE", 1.0),
    ("PSC_VELXY_FLTD", 1.0), ("PSC_VELXY_IMAX", 0.01), ("WPNAV_SPEED_UP", 0.01), ("WPNAV_SPEED_DN", 0.01),
    ("WPNAV_ACCEL_Z", 0.01), ("PSC_JERK_Z", 1.0), ("PSC_POSZ_P", 1.0), ("PSC_VELZ_P", 1.0),
    ("PSC_ACCZ_P", 0.1), ("PSC_ACCZ_I", 0.1), ("PSC_ACCZ_FLTE", 1.0), ("ANGLE_MAX", math.pi / 18000),
    ("ATC_INPUT_TC", 1.0), ("ATC_ANG_RLL_P", 1.0), ("ATC_ANG_PIT_P", 1.0), ("ATC_ANG_YAW_P", 1.0),
    ("ATC_ACCEL_R_MAX", math.pi / 18000), ("ATC_ACCEL_P_MAX", math.pi / 18000),
    ("ATC_ACCEL_Y_MAX", math.pi / 18000), ("ATC_RAT_RLL_P", 1.0), ("ATC_RAT_RLL_I", 1.0),
    ("ATC_RAT_RLL_D", 1.0), ("ATC_RAT_PIT_P", 1.0), ("ATC_RAT_PIT_I", 1.0), ("ATC_RAT_PIT_D", 1.0),
    ("ATC_RAT_YAW_P", 1.0), ("ATC_RAT_YAW_I", 1.0), ("ATC_RAT_RLL_FLTT", 1.0), ("ATC_RAT_RLL_FLTD", 1.0),
    ("INS_GYRO_FILTER", 1.0), ("MOT_THST_EXPO", 1.0), ("MOT_THST_HOVER", 1.0), ("MOT_SPIN_ARM", 1.0),
    ("MOT_SPIN_MIN", 1.0), ("MOT_SPIN_MAX", 1.0), ("MOT_SPOOL_TIME", 1.0), ("EMB_KV", 1.0), ("EMB_KT", 1.0),
    ("EMB_KB", 1.0), ("EMB_KZ", 1.0), ("EMB_KVZ", 1.0), ("EMB_KBZ", 1.0), ("EMB_KYAW", 1.0),
    ("RNGFND1_GNDCLR", 1.0),
)


def gain_index(name: str) -> int:
    """Place of a parameter in the array that `Parameters.gains` fills."""
    return next(i for i, (known, _) in enumerate(GAINS) if known == name)


class Parameters:
    """Values by name; integers are kept whole.

    Raises:
        UsageError: a name it does not have, or a value outside the limits.
    """

    def __init__(self, overrides: Mapping[str, float] | None = None) -> None:
        self._values = {d.name: float(d.default) for d in DEFINITIONS}
        self.gains: NDArray[np.float64] = np.zeros(len(GAINS))
        self.revision = 0
        for name, value in (overrides or {}).items():
            problem = self.set(name, value)
            if problem is not None:
                raise UsageError(f"embedded autopilot: {problem}")
        self._fill()

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def __contains__(self, name: object) -> bool:
        return name in self._values

    def __iter__(self) -> Iterator[Definition]:
        return iter(DEFINITIONS)

    def __len__(self) -> int:
        return len(DEFINITIONS)

    def set(self, name: str, value: float) -> str | None:
        """Change one; returns why not, or None when done."""
        definition = BY_NAME.get(name)
        if definition is None:
            near = get_close_matches(name, BY_NAME, n=1)
            return f"no parameter {name!r}" + (f", did you mean {near[0]}?" if near else "")
        if not math.isfinite(value) or not definition.low <= value <= definition.high:
            return f"{name} = {value:g} must be within {definition.low:g} .. {definition.high:g}"
        self._values[name] = float(np.float32(value)) if definition.kind == REAL else float(round(value))
        self.revision += 1
        self._fill()
        return None

    def _fill(self) -> None:
        for i, (name, factor) in enumerate(GAINS):
            self.gains[i] = self._values[name] * factor
