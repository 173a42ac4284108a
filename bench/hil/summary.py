"""What the journal of companion-in-the-loop flights says about the companion: checks, and a table for people."""

import shlex
from collections.abc import Sequence
from typing import Any

from bench.verdict import MEASURED, Check, Limit, Measurement, check, load_limits

COMPANION_UNITS = {"deadline_miss_share": "1", "setpoint_rate_hz": "Hz", "longest_gap_ms": "ms",
                   "setpoints_not_finite": "1"}
DEFAULT_LIMITS = "hil"
_BASIS = {"stamps": "by its own stamps and TIMESYNC", "arrivals": "by arrivals alone", None: "not measured"}


def load_companion_limits(name_or_path: str) -> list[Limit]:
    """Raises UsageError as `load_limits`."""
    return load_limits(name_or_path, tuple(COMPANION_UNITS))


def header_entry(echoes: str, vehicle: str, command: Sequence[str], limits: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """What the journal's header keeps."""
    return {"listen": echoes, "mavlink": vehicle, "command": list(command), "limits": list(limits)}


def _figures(trials: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    return [(t.get("link_counters") or {}).get("companion") or {} for t in trials]


def companion_checks(hil: dict[str, Any], trials: Sequence[dict[str, Any]]) -> list[Check]:
    """Every limit held against the worst flight. A flight in which a figure was not measured makes it unmeasured."""
    found = _figures(trials)
    checks = []
    for limit in (Limit(**d) for d in hil.get("limits", [])):
        values = [f.get(limit.name) for f in found]
        known = [float(v) for v in values if v is not None]
        worst = None
        if known and len(known) == len(values):
            worst = min(known) if limit.hi is None else max(known)
        setpoints = sum(int(f.get("setpoints") or 0) for f in found)
        checks.append(check(Measurement(worst, COMPANION_UNITS[limit.name], MEASURED, setpoints), limit))
    return checks


def with_companion(summary: dict[str, Any], hil: dict[str, Any], trials: Sequence[dict[str, Any]]) -> None:
    """Add `companion` to the summary, and the lines that fly each flight again."""
    found = _figures(trials)
    summary["companion"] = {
        **{key: hil.get(key) for key in ("listen", "mavlink")},
        "command": shlex.join(hil.get("command") or []) or "nothing: somebody connected",
        "origin": MEASURED, "flights": found, "table": _table(found),
    }
    for outcome, trial in zip(summary["outcomes"], trials, strict=True):
        outcome["replay"] = replay(hil, trial["request"], trial["seed"])


def replay(hil: dict[str, Any], request: dict[str, Any], seed: int) -> str:
    """The line that flies this one again; wall time does not repeat itself bit by bit."""
    words = ["saranga-bench", "hil", request["scene"], "--autopilot", request["autopilot"], "--shield",
             request["shield"], "--sonar", request["sonar"]]
    for name, value in (request.get("faults") or {}).items():
        words += ["--fault", f"{name}={value}"]
    words += ["--seed", str(seed), "--listen", str(hil.get("listen")), "--mavlink", str(hil.get("mavlink"))]
    return shlex.join(words) + (f" -- {shlex.join(hil['command'])}" if hil.get("command") else "")


def _table(found: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    rows = (
        ("deadline misses", _misses, "setpoints later than one tick (62.5 ms) after their echoes were taken"),
        ("measured", lambda f: _BASIS[f.get("basis")], "how the moment is known at which echoes were taken"),
        ("setpoint rate", lambda f: _number(f.get("setpoint_rate_hz"), "Hz"), "over the course; 16 Hz is wanted"),
        ("response", lambda f: _spread(f.get("response_ms")), "echoes taken to setpoint here: median (95 %, longest)"),
        ("latency", _latency, "cycle complete on the wire to the first setpoint that could have used it"),
        ("interval", lambda f: _spread(f.get("interval_ms")), "from setpoint to setpoint"),
        ("longest gap", lambda f: _number(f.get("longest_gap_ms"), "ms"), "the autopilot brakes after 3000 ms"),
        ("ticks without a setpoint", lambda f: _count(f.get("missed_ticks")), "of 62.5 ms"),
        ("setpoints not finite", lambda f: _count(f.get("setpoints_not_finite")), "not a number: the autopilot stops"),
        ("cycles sent, not taken", lambda f: f"{_count(f.get('echo_cycles'))}, {_count(f.get('echo_cycles_dropped'))}",
         "a companion that does not read loses whole cycles"),
        ("MAVLink frames lost", lambda f: _count(f.get("lost_mavlink_frames")), "gaps in its sequence numbers"),
        ("simulation lost", lambda f: _number(f.get("simulation_lost_s"), "s"),
         "on wall time, because this computer was busy; not the companion's fault"),
    )
    return [{"what": what, "cells": [cell(f) for f in found], "meaning": meaning} for what, cell, meaning in rows]


def _misses(figures: dict[str, Any]) -> str:
    misses, share = figures.get("deadline_misses"), figures.get("deadline_miss_share")
    return "–" if misses is None or share is None else f"{misses} of {figures.get('setpoints')} ({share:.1%})"


def _latency(figures: dict[str, Any]) -> str:
    return ("> " if figures.get("latency_is_lower_bound") else "") + _spread(figures.get("latency_ms"))


def _spread(values: dict[str, float] | None) -> str:
    return "–" if not values else f"{values['median']:.1f} ({values['p95']:.1f}, {values['max']:.1f}) ms"


def _number(value: float | None, unit: str) -> str:
    return "–" if value is None else f"{value:.1f} {unit}"


def _count(value: int | None) -> str:
    return "–" if value is None else str(value)


def companion_text(summary: dict[str, Any]) -> str:
    """The table for a terminal."""
    table = summary["companion"]["table"]
    wide = max(len(row["what"]) for row in table)
    lines = [f"  {row['what']:<{wide}}  {'; '.join(row['cells'])}" for row in table if row["cells"]]
    if summary["trials_planned"] == 1:  # the limits of several flights are in the summary's text already
        lines += [f"  limit {c['name']} {c['limit']}: {c['verdict']}: {c['why']}" for c in summary["checks"]
                  if c["name"] in COMPANION_UNITS]
    return "\n".join(["companion, measured at the ports in wall time:", *lines] if lines else [])
