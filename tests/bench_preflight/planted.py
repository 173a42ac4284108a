"""The faults that preflight must find: what is planted, and the check that must say so."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Planted:
    """`faults` in the vehicle or rig; `row` is the name of the check that must not pass, `words` part of the result.

    Attributes:
        row: "" where the link itself must be said to have failed.
        real_only: the embedded autopilot does not have what is broken.
    """

    faults: tuple[str, ...]
    row: str
    words: str = ""
    real_only: bool = False

    @property
    def title(self) -> str:
        return " ".join(self.faults)


def plant(text: str, row: str, words: str = "", real_only: bool = False) -> Planted:
    return Planted(tuple(text.split()), row, words, real_only)


VEHICLE = [
    # Sensors.
    plant("no_flow", "flow_rate_hz"),
    plant("flow_quality=3", "flow_quality"),
    plant("flow_every=25", "flow_rate_hz"),
    plant("no_range", "prearm_ok", "ange"),
    plant("range_offset_m=0.6", "ground_range_m"),
    plant("FLOW_TYPE=0", "parameters_different", "FLOW_TYPE 0"),
    plant("RNGFND1_TYPE=0", "parameters_different", "RNGFND1_TYPE 0"),
    plant("shake_m_s2=40", "vibration_m_s2", real_only=True),
    plant("SIM_BARO_DISABLE=1", "prearm_ok", real_only=True),
    # Power.
    plant("SIM_BATT_VOLTAGE=14.0", "battery_voltage_v", real_only=True),
    plant("BATT_MONITOR=0", "battery_voltage_v", "BYPASSED", real_only=True),
    # What protects.
    plant("BATT_LOW_VOLT=0", "battery_low_volt_v", "BYPASSED"),
    plant("BATT_FS_LOW_ACT=0", "failsafe_off BATT_FS_LOW_ACT", "BYPASSED"),
    plant("FS_EKF_ACTION=0", "failsafe_off FS_EKF_ACTION", "BYPASSED"),
    plant("FS_GCS_ENABLE=0", "failsafe_off FS_GCS_ENABLE", "BYPASSED"),
    plant("FS_CRASH_CHECK=0", "failsafe_off FS_CRASH_CHECK", "BYPASSED"),
    plant("ARMING_CHECK=0", "arming_checks_skipped", "BYPASSED"),
    plant("ARMING_CHECK=16", "arming_checks_skipped", "BYPASSED", real_only=True),
    plant("GUID_TIMEOUT=5", "guided_timeout_s"),
    plant("FLTMODE_GCSBLOCK=16", "guided_blocked", "GUIDED", real_only=True),
    plant("LOG_BACKEND_TYPE=0", "log_healthy", "BYPASSED", real_only=True),
    # Set-up.
    plant("COMPASS_USE=0 COMPASS_USE2=0 COMPASS_USE3=0", "yaw_settings_wrong", "no compass", real_only=True),
    plant("COMPASS_ENABLE=0", "yaw_settings_wrong", "no compass", real_only=True),
    plant("EK3_SRC1_YAW=8", "yaw_settings_wrong", real_only=True),
    plant("EK3_SRC1_VELXY=0", "ekf_flags_wrong", "horizontal", real_only=True),
    plant("MOT_THST_EXPO=0.3", "parameters_different", "MOT_THST_EXPO 0.3, wanted 0.55"),
    plant("ATC_RAT_RLL_P=0.3", "parameters_different", "ATC_RAT_RLL_P 0.3"),
    plant("no_origin", "origin_known"),
    # Who talks.
    plant("says_armed", "vehicle_armed", "armed"),
    plant("says_plane", "vehicle_is_quadrotor", "FIXED_WING"),
    plant("says_version=50724864", "firmware_version", "3.6", real_only=True),
    plant("second_vehicle", "other_vehicles", "system 7"),
    # The link.
    plant("silent", "", "no heartbeat"),
    plant("mute=EKF_STATUS_REPORT", "ekf_flags_wrong", "sent no EKF_STATUS_REPORT"),
    plant("mute=SYS_STATUS", "battery_voltage_v", "sent no SYS_STATUS"),
    plant("mute=AUTOPILOT_VERSION", "firmware_version", "AUTOPILOT_VERSION"),
    plant("mute=PARAM_VALUE", "parameters_different", "no parameters"),
    plant("mute=TIMESYNC", "round_trip_ms", "TIMESYNC"),
    plant("delay_ms=120", "round_trip_ms"),
    plant("stall_ms=300", "round_trip_jitter_ms"),
    plant("drop=0.3", "round_trips_lost_share"),
    plant("corrupt=0.1", "messages_bad_share"),
    plant("clock_jump_s=5", "clock_jump_s"),
]

RIG = [
    plant("swapped_sensors", "reflector_side", "swapped"),
    plant("dead_transmitter", "transmit_counts left", "no sound"),
    plant("missing_horn", "ring_down_ratio left", "horn"),
    plant("desync_us=800", "sync_coherence right", "desynchronised"),
    plant("dead_sensor=right", "frames_received_share right"),
    plant("noisy_sensor=left", "noise_floor_counts left", "too loud"),
    plant("link_errors=right", "link_wrong_share right"),
    plant("drops=0.05", "frames_lost_share"),
    plant("fop_drift_hz_s=20", "fop_drift_hz_s left", "drifting"),
    plant("clock_ppm=4000", "clock_drift_ppm"),
    plant("firmware=2.0", "", "firmware"),
    plant("hang_at_s=4", "", "hung"),
]


def caught(result: dict, planted: Planted) -> str:
    """Why this result did not name the fault; "" where it did."""
    rows = {row["name"]: row for row in result["checks"]}
    if result["go"] or result["verdict"] in ("PASS", "MARGINAL"):
        return f"it said {result['reason']}"
    if not planted.row:
        return "" if planted.words in result["reason"] else f"the reason lacks {planted.words!r}: {result['reason']}"
    row = rows.get(planted.row)
    if row is None:
        return f"there is no row {planted.row}"
    if row["verdict"] in ("PASS", "MARGINAL"):
        return f"{planted.row} is {row['verdict']}: {row['why']}; {result['reason']}"
    return "" if planted.words in row["why"] else f"{planted.row} lacks {planted.words!r}: {row['why']}"
