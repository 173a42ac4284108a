"""`saranga-bench stand check`: is a stand there, what does it measure, and is it at rest. Nothing spins."""

import contextlib
import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from bench.thrust_stand.calibration import negative_thrust
from bench.thrust_stand.protocol import StandInfo, StandReading, ThrustStand
from bench.verdict import Verdict, worst
from saranga.errors import DeviceError

WATCH_S = 1.5
LOWEST_RATE_HZ = 5.0
REST_SPREAD_N = 0.05
WANTED = ("thrust_n", "rpm", "voltage_v", "current_a")


@dataclass(frozen=True)
class StandCheck:
    """One check: what was found, the limit, and what to do where it is not met."""

    name: str
    verdict: Verdict
    value: str
    limit: str
    action: str = ""


def check_stand(stand: ThrustStand, watch_s: float = WATCH_S) -> dict[str, Any]:
    """Open, watch, tare, close. Never commands a throttle.

    Raises:
        DeviceError: it cannot be opened, or is lost on the way.
    """
    info = stand.open()
    try:
        readings = _all_of(stand) if info.origin == "recorded" else _watch(stand, watch_s)
        checks = [_measures(info), _finite(info, readings)]
        if info.origin == "recorded":
            checks.append(_sign(readings))
        else:
            checks += [_rate(readings, watch_s), _idle(readings), _rest(readings), _tare(stand.tare)]
    finally:
        stand.close()
    return _report(stand.url, info, readings, checks)


def _watch(stand: ThrustStand, watch_s: float) -> list[StandReading]:
    readings: list[StandReading] = []
    stand.read(0.0)
    end_s = time.monotonic() + watch_s
    while (left_s := end_s - time.monotonic()) > 0.0:
        readings += stand.read(left_s)
    return readings


def _all_of(stand: ThrustStand) -> list[StandReading]:
    readings: list[StandReading] = []
    with contextlib.suppress(DeviceError):  # a recording ends so
        while True:
            readings += stand.read(1.0)
    return readings


def _measures(info: StandInfo) -> StandCheck:
    missing = [name for name in WANTED if name not in info.quantities]
    found = ", ".join(sorted(info.quantities)) or "nothing"
    if "thrust_n" in missing:
        return StandCheck("measures", Verdict.FAIL, found, "thrust_n at least",
                          "check the load cell, its amplifier and its wiring")
    if missing:
        return StandCheck("measures", Verdict.MARGINAL, found, ", ".join(WANTED),
                          f"without {', '.join(missing)} there is no limit on it and no control by it")
    return StandCheck("measures", Verdict.PASS, found, ", ".join(WANTED))


def _finite(info: StandInfo, readings: list[StandReading]) -> StandCheck:
    bad = {name: sum(not math.isfinite(getattr(r, name)) for r in readings) for name in info.quantities}
    bad = {name: count for name, count in bad.items() if count}
    if not readings:
        return StandCheck("readings", Verdict.ERROR, "none", "some", "check that the stand streams")
    if bad and info.origin == "recorded" and "thrust_n" not in bad:
        return StandCheck("readings", Verdict.MARGINAL, f"{len(readings)}, of which not measured: {bad}", "all finite")
    if bad:
        return StandCheck("readings", Verdict.FAIL, f"{len(readings)}, of which NaN: {bad}", "all finite",
                          "check the sensor and its connector; such a reading stops a run")
    return StandCheck("readings", Verdict.PASS, f"{len(readings)}", "all finite")


def _rate(readings: list[StandReading], watch_s: float) -> StandCheck:
    rate_hz = len(readings) / watch_s
    verdict = Verdict.PASS if rate_hz >= LOWEST_RATE_HZ else Verdict.FAIL
    return StandCheck("rate", verdict, f"{rate_hz:.1f} readings/s", f"at least {LOWEST_RATE_HZ:g}",
                      "" if verdict is Verdict.PASS else "set the load cell's amplifier to its fast rate")


def _idle(readings: list[StandReading]) -> StandCheck:
    turning = [r for r in readings if r.throttle > 0.0 or r.rpm > 100.0]
    if turning:
        return StandCheck("idle", Verdict.FAIL, f"throttle {turning[-1].throttle:g}, {turning[-1].rpm:g} rpm", "idle",
                          "somebody else drives this motor: stop it")
    return StandCheck("idle", Verdict.PASS, "idle", "idle")


def _rest(readings: list[StandReading]) -> StandCheck:
    thrust = np.array([r.thrust_n for r in readings if math.isfinite(r.thrust_n)])
    spread = float(thrust.std()) if thrust.size > 1 else math.nan
    verdict = Verdict.PASS if spread <= REST_SPREAD_N else Verdict.FAIL
    return StandCheck("rest", verdict, f"thrust spreads by {spread:.4f} N", f"at most {REST_SPREAD_N:g} N",
                      "" if verdict is Verdict.PASS else "let the stand come to rest; check wiring and shielding")


def _tare(tare: Callable[[], float]) -> StandCheck:
    try:
        return StandCheck("tare", Verdict.PASS, f"offset {tare():.4f} N", "taken")
    except DeviceError as error:
        return StandCheck("tare", Verdict.FAIL, str(error), "taken", "see there")


def _sign(readings: list[StandReading]) -> StandCheck:
    wrong = negative_thrust(readings)
    if wrong:
        return StandCheck("sign", Verdict.FAIL, wrong, "thrust above 0 at speed", "thrust_sign=-1 where that is meant")
    return StandCheck("sign", Verdict.PASS, "thrust is above 0 at speed", "thrust above 0 at speed")


def _report(url: str, info: StandInfo, readings: list[StandReading], checks: list[StandCheck]) -> dict[str, Any]:
    last = {k: v for k, v in asdict(readings[-1]).items() if math.isfinite(v)} if readings else {}
    return {
        "verdict": worst(check.verdict for check in checks).value,
        "checks": [{**asdict(check), "verdict": check.verdict.value} for check in checks],
        "metrics": {"readings": len(readings), "last": last},
        "provenance": {"url": url, "name": info.name, "firmware": info.firmware, "origin": info.origin,
                       "quantities": sorted(info.quantities), "has_throttle": info.has_throttle,
                       "dead_man_s": info.dead_man_s},
        "outcomes": [],
        "run": None,
    }


def report_text(report: dict[str, Any]) -> str:
    """For people."""
    who = report["provenance"]
    throttle = f"throttle, dead-man {who['dead_man_s']:g} s" if who["dead_man_s"] else \
        "throttle without dead-man" if who["has_throttle"] else "no throttle"
    lines = [f"{who['url']}: {who['name']}, firmware {who['firmware']}; {who['origin']}; {throttle}"]
    for check in report["checks"]:
        advice = f"; {check['action']}" if check["action"] else ""
        lines.append(f"  {check['verdict']:<12} {check['name']:<9} {check['value']} (limit: {check['limit']}){advice}")
    lines.append(f"{report['verdict']}; the sign of the thrust can only be seen with the propeller turning"
                 if who["origin"] != "recorded" else report["verdict"])
    return "\n".join(lines)
