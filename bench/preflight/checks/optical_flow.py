"""Optical flow: it comes, often enough, and sees something."""

import itertools
from collections.abc import Callable

from bench.preflight.evidence import Evidence, Finding, VehicleEvidence, vehicle_check

NAME = "optical flow"
LIMITS = (("flow_rate_hz", "Hz"), ("flow_quality", "1"), ("flow_still_rad_s", "rad/s"))
ACTION = "check the sensor's plug and lens, FLOW_TYPE, light and the floor's texture"
FIELDS = ("flow_x", "flow_y", "flow_comp_m_x", "flow_comp_m_y", "flow_rate_x", "flow_rate_y", "quality")


def build() -> Callable[[Evidence], list[Finding]]:
    return vehicle_check(LIMITS, ACTION, examine)


def examine(vehicle: VehicleEvidence) -> list[Finding]:
    heard = vehicle.watched("OPTICAL_FLOW")
    seconds = vehicle.boot_seconds()
    # The autopilot repeats its newest reading at the rate asked for: only a change shows a new one.
    rows = [tuple(h.fields[key] for key in FIELDS) for h in heard]
    changes = sum(a != b for a, b in itertools.pairwise(rows))
    rate = changes / seconds if seconds else None
    newest = heard[-1].t_s if heard else vehicle.watch_s[1]
    quality = min((float(h.fields["quality"]) for h in heard), default=None)
    rates = [abs(float(h.fields[key])) for h in heard for key in ("flow_rate_x", "flow_rate_y")]
    none = "" if heard else "no optical flow came"
    return [
        Finding("flow_rate_hz", rate, "Hz", ACTION, heard_s=newest, seen=none or f"{changes} new readings",
                blocked="" if seconds else "it sent no SYSTEM_TIME to measure the rate with"),
        Finding("flow_quality", quality, "1", ACTION, heard_s=newest, samples=len(heard), blocked=none,
                seen="lowest during the watch"),
        Finding("flow_still_rad_s", sorted(rates)[len(rates) // 2] if rates else None, "rad/s",
                "it stands still and sees motion: keep hands and shadows away, check the lens", heard_s=newest,
                samples=len(heard), blocked=none),
    ]
