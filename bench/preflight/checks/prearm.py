"""The autopilot's own arming checks: asked to run them now, and listened to."""

from collections.abc import Callable

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from bench.preflight.evidence import Evidence, Finding, VehicleEvidence, vehicle_check

NAME = "prearm"
LIMITS = (("prearm_ok", "1"), ("prearm_messages", "1"))
ACTION = "do what the autopilot's message says"


def build() -> Callable[[Evidence], list[Finding]]:
    return vehicle_check(LIMITS, ACTION, examine)


def examine(vehicle: VehicleEvidence) -> list[Finding]:
    status = vehicle.last("SYS_STATUS")
    asked_s = vehicle.prearm_asked_s
    said = list(dict.fromkeys(text for t_s, _, text in vehicle.texts
                              if asked_s is not None and t_s >= asked_s - 0.01 and text.lower().startswith("prearm")))
    before = [text for _, _, text in vehicle.texts if text.lower().startswith("prearm")]
    if status is None:
        first = Finding("prearm_ok", None, "1", ACTION, blocked="it sent no SYS_STATUS")
    else:
        present = int(status.fields["onboard_control_sensors_present"]) & mavlink.MAV_SYS_STATUS_PREARM_CHECK
        good = int(status.fields["onboard_control_sensors_health"]) & mavlink.MAV_SYS_STATUS_PREARM_CHECK
        first = Finding("prearm_ok", float(bool(good)), "1", ACTION, heard_s=status.t_s,
                        seen="; ".join(said or before[-3:]) or "ready to arm",
                        blocked="" if present else "it does not say whether it may arm")
    accepted = vehicle.prearm_result == mavlink.MAV_RESULT_ACCEPTED
    return [first, Finding("prearm_messages", float(len(said)), "1", ACTION, heard_s=asked_s, seen="; ".join(said),
                           blocked="" if accepted or said else
                           f"it did not run its checks when asked (answer {vehicle.prearm_result})")]
