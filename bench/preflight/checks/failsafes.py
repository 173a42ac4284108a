"""Failsafes: each is on. One that is off, or that the firmware lacks, is shouted out."""

from collections.abc import Callable

from bench.preflight.evidence import Evidence, Finding, VehicleEvidence, vehicle_check

NAME = "failsafes"
LIMITS = (("failsafe_off", "1"), ("battery_low_volt_v", "V"))
ACTION = "switch it on: fixtures/parameters has values, --fix-parameters sets those"
# Parameter -> what it does when something is lost. 0 is off for all of them.
ACTIONS = {"FS_EKF_ACTION": "estimate lost", "FS_GCS_ENABLE": "ground station lost",
           "BATT_FS_LOW_ACT": "battery low", "FS_CRASH_CHECK": "crash"}


def build() -> Callable[[Evidence], list[Finding]]:
    return vehicle_check(LIMITS, ACTION, examine)


def examine(vehicle: VehicleEvidence) -> list[Finding]:
    if not vehicle.parameters:
        return [Finding(name, None, unit, ACTION, blocked="it sent no parameters") for name, unit in LIMITS]
    findings = []
    for name, when in ACTIONS.items():
        value = vehicle.parameter(name)
        off = value is None or value <= 0
        findings.append(Finding(
            "failsafe_off", float(off), "1", f"{ACTION} ({name})", of=name, heard_s=vehicle.parameters_s,
            seen=f"{when}: {name} {'absent' if value is None else f'{value:g}'}",
            bypassed=f"{name} is {'absent' if value is None else '0'}: nothing happens when {when}" if off else ""))
    low = vehicle.parameter("BATT_LOW_VOLT")
    findings.append(Finding("battery_low_volt_v", low, "V", "set BATT_LOW_VOLT to 3.5 V a cell",
                            heard_s=vehicle.parameters_s,
                            bypassed="BATT_LOW_VOLT is 0: no voltage is low" if low == 0 else "",
                            blocked="" if low is not None else "the firmware has no BATT_LOW_VOLT"))
    return findings
