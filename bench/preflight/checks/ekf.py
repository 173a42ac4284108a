"""The state estimate: the flags that flying on flow needs, and its variances."""

from collections.abc import Callable

from bench.preflight.evidence import Evidence, Finding, VehicleEvidence, vehicle_check

NAME = "ekf"
LIMITS = (("ekf_flags_wrong", "1"), ("ekf_variance", "1"))
ACTION = "keep it still on a floor with texture and light until the estimate has settled; is the origin set?"
NEEDED = {1: "attitude", 2: "horizontal velocity", 4: "vertical velocity", 8: "relative horizontal position",
          32: "height", 64: "height above ground"}
FORBIDDEN = {128: "position held constant", 1024: "uninitialised", 32768: "GPS glitch"}
VARIANCES = ("velocity_variance", "pos_horiz_variance", "pos_vert_variance", "compass_variance",
             "terrain_alt_variance")


def build() -> Callable[[Evidence], list[Finding]]:
    return vehicle_check(LIMITS, ACTION, examine)


def examine(vehicle: VehicleEvidence) -> list[Finding]:
    heard = vehicle.watched("EKF_STATUS_REPORT")
    if not heard:
        return [Finding(name, None, unit, ACTION, blocked="it sent no EKF_STATUS_REPORT") for name, unit in LIMITS]
    wrong: dict[str, None] = {}
    for report in heard:
        flags = int(report.fields["flags"])
        wrong |= dict.fromkeys(f"no {what}" for bit, what in NEEDED.items() if not flags & bit)
        wrong |= dict.fromkeys(what for bit, what in FORBIDDEN.items() if flags & bit)
    worst_of = {name: max(float(h.fields[name]) for h in heard) for name in VARIANCES}
    name = max(worst_of, key=lambda key: worst_of[key])
    return [
        Finding("ekf_flags_wrong", float(len(wrong)), "1", ACTION, samples=len(heard), heard_s=heard[-1].t_s,
                seen=", ".join(wrong) or f"flags {int(heard[-1].fields['flags'])}"),
        Finding("ekf_variance", worst_of[name], "1", ACTION, samples=len(heard), heard_s=heard[-1].t_s, seen=name),
    ]
