"""Every check on recorded evidence of a real ArduCopter: clean is a GO, each planted fault is a NO-GO that names it."""

from dataclasses import replace

import pytest
from parked_link import judged
from planted import Planted, caught

import bench.preflight.checks
from bench.preflight.collect import ARMED
from bench.preflight.evidence import Evidence, Heard
from bench.preflight.judge import check_names, known_limits
from saranga.errors import UsageError
from saranga.plugins import plugins


def each(evidence: Evidence, name: str, **fields: float) -> None:
    """Change fields in every message of a name."""
    heard = evidence.vehicle.messages[name]
    evidence.vehicle.messages[name] = [Heard(h.t_s, h.fields | fields) for h in heard]


def health(evidence: Evidence, bit: int) -> None:
    bits = evidence.vehicle.messages["SYS_STATUS"][0].fields["onboard_control_sensors_health"]
    each(evidence, "SYS_STATUS", onboard_control_sensors_health=bits & ~bit)


def parameter(name: str, value: float):
    return lambda evidence: evidence.vehicle.parameters.update({name: value})


def without(name: str):
    return lambda evidence: evidence.vehicle.messages.pop(name)


def said(severity: int, text: str):
    def change(evidence: Evidence) -> None:
        evidence.vehicle.texts.append((evidence.vehicle.prearm_asked_s + 0.2, severity, text))

    return change


def jump(evidence: Evidence) -> None:
    heard = evidence.vehicle.messages["SYSTEM_TIME"]
    late = heard[len(heard) // 2].t_s
    evidence.vehicle.messages["SYSTEM_TIME"] = [
        Heard(h.t_s, h.fields | {"time_boot_ms": h.fields["time_boot_ms"] + 3000 * (h.t_s > late)}) for h in heard]


def turning(evidence: Evidence) -> None:
    heard = evidence.vehicle.messages["ATTITUDE"]
    evidence.vehicle.messages["ATTITUDE"] = [
        Heard(h.t_s, h.fields | {"yaw": 0.02 * (h.t_s - heard[0].t_s)}) for h in heard]


def clipping(evidence: Evidence) -> None:
    last = evidence.vehicle.messages["VIBRATION"][-1]
    last.fields["clipping_0"] += 4


def stack(**fields):
    def change(evidence: Evidence) -> None:
        evidence.stack = replace(evidence.stack, **fields)

    return change


def vehicle(**fields):
    def change(evidence: Evidence) -> None:
        for name, value in fields.items():
            setattr(evidence.vehicle, name, value)

    return change


# name -> what is changed, the row that must not pass, and words of its reason.
PLANTED = {
    "no flow": (without("OPTICAL_FLOW"), "flow_rate_hz", "no optical flow"),
    "flow frozen": (lambda e: each(e, "OPTICAL_FLOW", flow_comp_m_x=0.0, flow_comp_m_y=0.0, flow_rate_x=0.0,
                                   flow_rate_y=0.0, flow_x=0, flow_y=0), "flow_rate_hz", "0 new readings"),
    "flow of poor quality": (lambda e: each(e, "OPTICAL_FLOW", quality=4), "flow_quality", ""),
    "flow sees motion": (lambda e: each(e, "OPTICAL_FLOW", flow_rate_x=0.6), "flow_still_rad_s", ""),
    "no range": (without("DISTANCE_SENSOR"), "ground_range_messages_hz", "no downward"),
    "range forward": (lambda e: each(e, "DISTANCE_SENSOR", orientation=0), "ground_range_messages_hz", "no downward"),
    "range too far": (lambda e: each(e, "DISTANCE_SENSOR", current_distance=60), "ground_range_m", ""),
    "range under the legs": (lambda e: each(e, "DISTANCE_SENSOR", current_distance=0), "ground_range_m", ""),
    "battery low": (lambda e: each(e, "SYS_STATUS", voltage_battery=14200), "battery_voltage_v", ""),
    "battery too high": (lambda e: each(e, "SYS_STATUS", voltage_battery=25000), "battery_voltage_v", ""),
    "battery unknown": (lambda e: each(e, "SYS_STATUS", voltage_battery=65535), "battery_voltage_v", "not measure"),
    "battery sags": (lambda e: e.vehicle.messages["SYS_STATUS"][-8].fields.update(voltage_battery=15900),
                     "battery_sag_v", ""),
    "battery nearly empty": (lambda e: each(e, "SYS_STATUS", battery_remaining=20), "battery_remaining_percent", ""),
    "nobody watches the battery": (parameter("BATT_MONITOR", 0), "battery_voltage_v", "BYPASSED"),
    "vibration": (lambda e: each(e, "VIBRATION", vibration_z=22.0), "vibration_m_s2", ""),
    "clipping": (clipping, "accelerometer_clips", ""),
    "leaning": (lambda e: each(e, "ATTITUDE", roll=0.3), "lean_deg", ""),
    "rocking": (lambda e: each(e, "ATTITUDE", pitchspeed=0.4), "turning_rad_s", ""),
    "heading drifts": (turning, "heading_drift_deg_min", ""),
    "no compass used": (lambda e: [parameter(f"COMPASS_USE{n}", 0)(e) for n in ("", 2, 3)], "yaw_settings_wrong",
                        "no compass"),
    "compass off": (parameter("COMPASS_ENABLE", 0), "yaw_settings_wrong", "no compass"),
    "yaw source none, compass on": (parameter("EK3_SRC1_YAW", 0), "yaw_settings_wrong", "COMPASS_USE is 1"),
    "yaw from GPS": (parameter("EK3_SRC1_YAW", 2), "yaw_settings_wrong", "indoor"),
    "EKF without velocity": (lambda e: each(e, "EKF_STATUS_REPORT", flags=167), "ekf_flags_wrong", "held constant"),
    "EKF variance": (lambda e: each(e, "EKF_STATUS_REPORT", compass_variance=0.9), "ekf_variance", "compass"),
    "EKF silent": (without("EKF_STATUS_REPORT"), "ekf_flags_wrong", "sent no EKF"),
    "prearm refused": (lambda e: health(e, 0x10000000), "prearm_ok", ""),
    "prearm message": (said(2, "PreArm: Compass not calibrated"), "prearm_messages", "Compass not calibrated"),
    "prearm not answered": (vehicle(prearm_result=None), "prearm_messages", "did not run"),
    "gyro unhealthy": (lambda e: health(e, 1), "sensors_unhealthy", "gyro"),
    "barometer absent": (lambda e: each(e, "SYS_STATUS", onboard_control_sensors_present=0x53320027 & ~8),
                         "sensors_absent", "absolute pressure"),
    "error text": (said(2, "EKF variance"), "alarming_texts", "EKF variance"),
    "no log": (parameter("LOG_BACKEND_TYPE", 0), "log_healthy", "BYPASSED"),
    "log unhealthy": (lambda e: health(e, 1 << 24), "log_healthy", ""),
    "arming checks off": (parameter("ARMING_CHECK", 0), "arming_checks_skipped", "BYPASSED"),
    "some arming checks off": (parameter("ARMING_CHECK", 0x7FFE), "arming_checks_skipped", "BYPASSED"),
    "arming checks skipped, new name": (parameter("ARMING_SKIPCHK", 4), "arming_checks_skipped", "BYPASSED"),
    "no origin": (without("GPS_GLOBAL_ORIGIN"), "origin_known", "told none"),
    "GUIDED closed": (parameter("FLTMODE_GCSBLOCK", 16), "guided_blocked", "closes GUIDED"),
    "no time-out": (parameter("GUID_TIMEOUT", 60), "guided_timeout_s", ""),
    "no GUID_TIMEOUT": (lambda e: e.vehicle.parameters.pop("GUID_TIMEOUT"), "guided_timeout_s", "no GUID_TIMEOUT"),
    "EKF failsafe off": (parameter("FS_EKF_ACTION", 0), "failsafe_off FS_EKF_ACTION", "BYPASSED"),
    "GCS failsafe off": (parameter("FS_GCS_ENABLE", 0), "failsafe_off FS_GCS_ENABLE", "BYPASSED"),
    "GCS failsafe absent": (lambda e: e.vehicle.parameters.pop("FS_GCS_ENABLE"), "failsafe_off FS_GCS_ENABLE",
                            "absent"),
    "battery failsafe off": (parameter("BATT_FS_LOW_ACT", 0), "failsafe_off BATT_FS_LOW_ACT", "BYPASSED"),
    "crash check off": (parameter("FS_CRASH_CHECK", 0), "failsafe_off FS_CRASH_CHECK", "BYPASSED"),
    "no low voltage": (parameter("BATT_LOW_VOLT", 0), "battery_low_volt_v", "BYPASSED"),
    "parameter differs": (parameter("MOT_THST_EXPO", 0.3), "parameters_different", "MOT_THST_EXPO 0.3, wanted 0.55"),
    "parameter missing": (lambda e: e.vehicle.parameters.pop("FLOW_TYPE"), "parameters_absent", "FLOW_TYPE"),
    "parameters unread": (lambda e: setattr(e.vehicle, "parameter_count", 1400), "parameters_unread", "of 1400"),
    "aeroplane": (lambda e: each(e, "HEARTBEAT", type=1), "vehicle_is_quadrotor", "FIXED_WING"),
    "PX4": (lambda e: each(e, "HEARTBEAT", autopilot=12), "vehicle_is_ardupilot", "PX4"),
    "old firmware": (lambda e: each(e, "AUTOPILOT_VERSION", flight_sw_version=0x03060000), "firmware_version", "3.6"),
    "unknown firmware": (without("AUTOPILOT_VERSION"), "firmware_version", "did not answer"),
    "two vehicles": (vehicle(other_vehicles=(7,)), "other_vehicles", "system 7"),
    "clock jumps": (jump, "clock_jump_s", ""),
    "clock silent": (without("SYSTEM_TIME"), "clock_jump_s", "only 0"),
    "late link": (vehicle(round_trips_ms=[140.0] * 60), "round_trip_ms", ""),
    "jittery link": (vehicle(round_trips_ms=[5.0] * 40 + [180.0] * 20), "round_trip_jitter_ms", ""),
    "lossy link": (vehicle(round_trips_ms=[5.0] * 30), "round_trips_lost_share", ""),
    "no round trips": (vehicle(round_trips_ms=[]), "round_trip_ms", "no answer"),
    "damaged messages": (vehicle(bad_messages=60), "messages_bad_share", ""),
    "heartbeats missing": (lambda e: e.vehicle.messages["HEARTBEAT"].__delitem__(slice(2, 7)), "heartbeat_gap_s", ""),
    "slow stack": (stack(step_ms=[55.0] * 120), "tick_headroom", ""),
    "stack that stalls": (stack(step_ms=[4.0] * 110 + [70.0] * 10), "tick_headroom", ""),
    "stack that cannot run": (stack(failed="no runtime", step_ms=[]), "stack_step_ms", "no runtime"),
    "other weights": (stack(weights_found={"int8": "c" * 64, "fp32": "b" * 64}), "weights_wrong", "int8"),
    "weights missing": (stack(weights_found={"int8": "", "fp32": "b" * 64}), "weights_wrong", "int8"),
    "disk full": (stack(free_bytes=10**8), "disk_free_gb", ""),
    "computer's clock unset": (stack(utc_year=1970), "clock_year", ""),
    "MAVSDK sees another version": (lambda e: e.mavsdk.update(version=[4, 5, 7]), "mavsdk_version_differs", ""),
    "MAVSDK sees it uncalibrated": (lambda e: e.mavsdk.update(health={"gyroscope calibrated": False}),
                                    "mavsdk_unhealthy", "gyroscope"),
    "MAVSDK sees another battery": (lambda e: e.mavsdk.update(voltage_v=12.0), "mavsdk_voltage_difference_v", ""),
    "no rig": (lambda e: setattr(e, "rig", None), "rig_link", ""),
    "no vehicle": (lambda e: setattr(e, "vehicle", None), "prearm_ok", ""),
    "no stack": (lambda e: setattr(e, "stack", None), "stack_step_ms", ""),
    "stale evidence": (lambda e: setattr(e, "now_s", e.now_s + 300.0), "prearm_ok", "old"),
}


def test_a_clean_vehicle_is_a_go(clean):
    result = judged(clean)
    assert result["go"] and result["verdict"] == "PASS", result["reason"]
    assert result["reason"].startswith("GO: ") and "rehearsal" in result["reason"]
    assert len(result["checks"]) >= 80


@pytest.mark.parametrize("name", PLANTED)
def test_a_planted_fault_is_a_no_go_that_names_it(clean, name):
    change, row, words = PLANTED[name]
    change(clean)
    result = judged(clean)
    assert caught(result, Planted((name,), row, words)) == ""
    assert result["reason"].startswith("NO-GO: ")


def test_every_row_has_what_the_contract_says(clean):
    PLANTED["battery low"][0](clean)
    for row in judged(clean)["checks"]:
        assert row["name"] and row["limit"] and row["source"] and row["action"] and row["why"], row
        assert row["age_s"] is not None and row["age_s"] >= 0
        assert row["origin"] in ("simulated", "emulated", "measured")
        assert (row["action"] == "nothing") == (row["verdict"] == "PASS")


def test_what_failed_comes_first_with_its_next_action(clean):
    PLANTED["battery low"][0](clean)
    clean.mavsdk["voltage_v"] = 14.2
    first = judged(clean)["checks"][0]
    assert first["name"] == "battery_voltage_v" and first["value"] == pytest.approx(14.2)
    assert "charge" in first["action"] and first["limit"] == ">= 14.8 and <= 17 V"


def test_causes_come_before_what_suffers_from_them(clean):
    PLANTED["EKF without velocity"][0](clean)
    PLANTED["prearm refused"][0](clean)
    PLANTED["no compass used"][0](clean)
    names = [row["name"] for row in judged(clean)["checks"] if row["verdict"] == "FAIL"]
    assert names.index("yaw_settings_wrong") < names.index("ekf_flags_wrong")


def test_nothing_at_all_passes_nothing_but_lists_everything():
    result = judged(Evidence())
    assert not result["go"]
    assert {row["verdict"] for row in result["checks"]} == {"INCONCLUSIVE"}
    assert {row["check"] for row in result["checks"]} >= set(plugins(bench.preflight.checks)) - {"mavsdk"}


@pytest.mark.parametrize("name", check_names())
def test_a_skipped_check_shouts_and_is_no_go(clean, name):
    result = judged(clean, skip=(name,))
    assert not result["go"] and result["verdict"] == "INCONCLUSIVE"
    assert result["bypassed"] and "BYPASSED by --skip" in result["reason"]


def test_skipping_does_not_hide_a_failure(clean):
    PLANTED["battery low"][0](clean)
    assert judged(clean, skip=("battery",))["verdict"] == "FAIL"


def test_skipping_what_does_not_exist_is_bad_input(clean):
    with pytest.raises(UsageError, match=r"no such check \(did you mean 'battery'"):
        judged(clean, skip=("batery",))


def test_an_armed_vehicle_is_a_no_go_and_nothing_else_is_judged(clean):
    each(clean, "HEARTBEAT", base_mode=209)
    clean.vehicle.stopped = ARMED
    result = judged(clean)
    rows = {row["name"]: row for row in result["checks"]}
    assert result["verdict"] == "FAIL" and "vehicle is armed" in result["reason"]
    assert rows["battery_voltage_v"]["verdict"] == "INCONCLUSIVE"


def test_mavsdk_absent_is_a_remark_not_a_no_go(clean):
    clean.mavsdk = {"failed": "MAVSDK is not installed"}
    result = judged(clean)
    assert result["go"] and result["verdict"] == "MARGINAL"


def test_compass_free_is_a_good_set_up_of_its_own(clean):
    for n in ("", 2, 3):
        clean.vehicle.parameters[f"COMPASS_USE{n}"] = 0.0
    clean.vehicle.parameters["EK3_SRC1_YAW"] = 0.0
    rows = {row["name"]: row for row in judged(clean)["checks"]}
    assert rows["yaw_settings_wrong"]["verdict"] == "PASS"
    assert "free of the compass" in rows["yaw_settings_wrong"]["why"]


def test_the_names_of_4_5_are_understood(clean):
    parameters = clean.vehicle.parameters
    for new, old, factor in (("GPS1_TYPE", "GPS_TYPE", 1), ("RNGFND1_MIN", "RNGFND1_MIN_CM", 100),
                             ("RNGFND1_MAX", "RNGFND1_MAX_CM", 100), ("RNGFND1_GNDCLR", "RNGFND1_GNDCLEAR", 100)):
        parameters[old] = parameters.pop(new) * factor
    parameters["SIM_GPS_DISABLE"] = 1.0
    del parameters["SIM_GPS1_ENABLE"]
    each(clean, "AUTOPILOT_VERSION", flight_sw_version=0x040507FF)
    clean.mavsdk["version"] = [4, 5, 7]
    clean.vehicle.parameter_count = len(parameters)
    result = judged(clean)
    assert result["go"], result["reason"]
    parameters["RNGFND1_MIN_CM"] = 20.0
    assert "RNGFND1_MIN_CM 20, wanted 2" in judged(clean)["reason"]


def test_a_real_flight_controller_is_not_asked_for_a_simulators_parameters(clean):
    parameters = clean.vehicle.parameters
    for name in [name for name in parameters if name.startswith("SIM_")]:
        del parameters[name]
    parameters["SCHED_LOOP_RATE"] = 400.0
    clean.vehicle.parameter_count = len(parameters)
    rows = {row["name"]: row for row in judged(clean)["checks"]}
    assert rows["parameters_different"]["verdict"] == rows["parameters_absent"]["verdict"] == "PASS"
    assert rows["parameters_different"]["origin"] == "measured"
    assert "clock_rate_error" in rows


def test_a_check_that_crashes_is_an_error_not_a_pass(clean):
    each(clean, "EKF_STATUS_REPORT", flags=float("nan"))
    result = judged(clean)
    rows = {row["name"]: row for row in result["checks"]}
    assert rows["ekf (crashed)"]["verdict"] == "ERROR" and not result["go"]


def test_every_limit_is_used_and_every_row_has_one(clean):
    rows = judged(clean)["checks"]
    ours = [row for row in rows if row["check"] == "rig reflector" or not row["check"].startswith("rig ")]
    used = {row["name"].split()[0] for row in ours}
    # Of other vehicles: a real one, the embedded one, one that MAVSDK does not answer for.
    elsewhere = {"clock_rate_error", "firmware_embedded_version", "mavsdk_answers", "evidence_age_s"}
    assert used | elsewhere == set(known_limits())
