"""The battery: its voltage, what is left, and how steady it is while nothing draws from it."""

from collections.abc import Callable

from bench.preflight.evidence import Evidence, Finding, VehicleEvidence, vehicle_check

NAME = "battery"
LIMITS = (("battery_voltage_v", "V"), ("battery_sag_v", "V"), ("battery_remaining_percent", "%"))
ACTION = "charge or change the battery; check BATT_MONITOR and the sense wire"


def build() -> Callable[[Evidence], list[Finding]]:
    return vehicle_check(LIMITS, ACTION, examine)


def examine(vehicle: VehicleEvidence) -> list[Finding]:
    heard = vehicle.watched("SYS_STATUS")
    monitor = vehicle.parameter("BATT_MONITOR")
    volts = [float(h.fields["voltage_battery"]) * 1e-3 for h in heard]
    left = [float(h.fields["battery_remaining"]) for h in heard]
    newest = heard[-1].t_s if heard else None
    unknown = [v for v in volts if v >= 65.0]
    off = monitor == 0.0
    none = "it sent no SYS_STATUS" if not heard else "it does not measure its battery" if unknown and not off else ""
    bypassed = "BATT_MONITOR is 0: nobody watches the battery" if off else ""
    return [
        Finding("battery_voltage_v", min(volts) if volts and not off else 0.0 if off else None, "V", ACTION,
                heard_s=newest, samples=len(volts), blocked=none, bypassed=bypassed, seen="lowest during the watch"),
        Finding("battery_sag_v", max(volts) - min(volts) if volts else None, "V", ACTION, heard_s=newest,
                samples=len(volts), blocked=none or bypassed, seen="highest less lowest, motors still"),
        Finding("battery_remaining_percent", left[-1] if left else None, "%", ACTION, heard_s=newest,
                blocked=none or ("" if left and left[-1] >= 0.0 else "its capacity is not known (BATT_CAPACITY)")),
    ]
