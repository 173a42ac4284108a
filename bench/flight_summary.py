"""From the journal of flights to the verdict and the JSON that scripts read. Nothing but the journal goes in.

How flights are judged:

- One flight: its outcome is the verdict. Clean and landed is PASS; "infrastructure" (the bench, the
  autopilot's process or the stack itself broke) is ERROR; interrupted is INCONCLUSIVE; else FAIL.
- Several flights with limits: rates are held to their limit by Wilson's interval (see `verdict.check_rate`).
- Several flights without limits: every flight must pass.

A flight that ended as "infrastructure" says nothing about the vehicle, so it is left out of every rate, and
it makes the whole run an ERROR, whatever the others did. A run that was cut short is INCONCLUSIVE at best.

A pytest session (run kind "test") is judged by its tests instead, since a test may well want a flight to fail.
"""

import dataclasses
import hashlib
import math
import shlex
from collections.abc import Sequence
from statistics import median
from typing import Any

from bench.journal import Records
from bench.statistics import wilson_interval
from bench.verdict import MEASURED, SIMULATED, Check, Limit, Measurement, Verdict, check, check_rate, worst

METRIC_UNITS = {
    "success_rate": "1",
    "success_rate_strict": "1",
    "realtime_factor": "1",
    "min_clearance_m": "m",
    "duration_s": "s",
}
# The speed of the simulator is read from a real clock; everything else here happened in a simulated world.
METRIC_ORIGINS = dict.fromkeys(METRIC_UNITS, SIMULATED) | {"realtime_factor": MEASURED}
REQUEST_KEYS = ("autopilot", "denoiser", "stack", "shield", "sonar")
DEFAULT_MAX_SIM_S = 180.0
NOT_JUDGED = ("infrastructure", "interrupted")
FAILURES = ("net_hit", "obstacle_hit", "timeout", "stuck", "estimator_failure")


def trial_verdict(result: dict[str, Any]) -> Verdict:
    """Verdict of one flight from its outcome (see the module). An outcome nobody knows is an ERROR."""
    outcome = result.get("outcome")
    if outcome == "clean":
        return Verdict.PASS if result.get("success_strict") is True else Verdict.FAIL
    if outcome == "interrupted":
        return Verdict.INCONCLUSIVE
    return Verdict.FAIL if outcome in FAILURES else Verdict.ERROR


def limit_to_dict(limit: Limit) -> dict[str, Any]:
    """For the journal's header; `Limit(**dict)` is the way back."""
    return dataclasses.asdict(limit)


def summarise(journal: Records) -> dict[str, Any]:
    """The JSON object of a fly run: verdict, outcomes, metrics, checks, provenance, run, errors, warnings."""
    header = journal.header
    trials = _trials(journal)
    judged = [t for t in trials if t["outcome"] not in NOT_JUDGED]
    metrics, limits = _metrics(trials, judged), [Limit(**d) for d in header.get("limits", [])]
    checks = [_check(limit, metrics, judged) for limit in limits]
    hil = header.get("hil")
    if hil is not None:
        from bench.hil.summary import companion_checks

        checks += companion_checks(hil, trials)
    errors = [r["error"] for r in journal.of("error")]
    if journal.damaged_lines:
        errors.append(f"journal lines {journal.damaged_lines} cannot be read")
    planned = len(header.get("seeds", []))
    interrupted = bool(journal.of("interrupted")) or journal.end is None or len(trials) < planned
    rates = [c for c in checks if c.name in ("success_rate", "success_rate_strict")]
    metrics["trials_needed"] = max((c.trials_needed for c in rates if c.trials_needed is not None), default=None)
    if header["run_kind"] == "test":
        verdict = _test_verdict(journal, bool(errors), interrupted)
    else:
        verdict = _verdict(trials, checks, planned, bool(errors), interrupted)
    summary = {
        "verdict": verdict.value,
        "outcomes": [_outcome(t, header.get("live", False)) for t in trials],
        "metrics": metrics,
        "metrics_detail": {
            name: {"value": metrics[name], "unit": unit, "origin": METRIC_ORIGINS[name]}
            for name, unit in METRIC_UNITS.items()
        },
        "checks": [c.to_dict() for c in checks],
        "provenance": _provenance(header, trials),
        "run": header.get("run"),
        "trials_planned": planned,
        "interrupted": interrupted,
        "errors": errors,
        "warnings": [r["text"] for r in journal.of("warning")],
    }
    if hil is not None:
        from bench.hil.summary import with_companion

        with_companion(summary, hil, trials)
    return summary


def exit_code(summary: dict[str, Any]) -> int:
    """130 when the operator ended the run, else by the verdict."""
    return 130 if summary["interrupted"] and not summary["errors"] else Verdict(summary["verdict"]).exit_code


def replay_command(request: dict[str, Any], seed: int, live: bool = False) -> str:
    """The line that flies this one again."""
    words = [
        "saranga-bench",
        "fly",
        request["scene"],
        "--autopilot",
        request["autopilot"],
        "--stack",
        request["stack"],
        "--denoiser",
        request["denoiser"],
        "--shield",
        request["shield"],
        "--sonar",
        request["sonar"],
    ]
    for name, value in request.get("faults", {}).items():
        words += ["--fault", f"{name}={value}"]
    if request.get("max_sim_s", DEFAULT_MAX_SIM_S) != DEFAULT_MAX_SIM_S:
        words += ["--max-sim-s", f"{request['max_sim_s']:g}"]
    return shlex.join([*words, "--seed", str(seed), *(["--live"] if live else [])])


def _trials(journal: Records) -> list[dict[str, Any]]:
    """Results in the order flown, each with the files that were saved for it afterwards."""
    trials: list[dict[str, Any]] = []
    for record in journal.records:
        if record["kind"] == "trial":
            trials.append({**record["result"], "files": {}, "request": record["request"]})
        elif record["kind"] == "files" and trials and trials[-1]["seed"] == record["seed"]:
            trials[-1]["files"] = record["files"]
    return trials


def _verdict(
    trials: Sequence[dict[str, Any]], checks: Sequence[Check], planned: int, errors: bool, interrupted: bool
) -> Verdict:
    each = [trial_verdict(t) for t in trials]
    parts = [Verdict.ERROR] if errors or Verdict.ERROR in each else []
    if interrupted:
        parts.append(Verdict.INCONCLUSIVE)
    rates = [c for c in checks if c.name in ("success_rate", "success_rate_strict")]
    parts += [c.verdict for c in checks if c not in rates]
    parts += [c.verdict for c in rates] if rates and planned > 1 else each
    return worst(parts)


def _test_verdict(journal: Records, errors: bool, interrupted: bool) -> Verdict:
    outcomes = {r["outcome"] for r in journal.of("test")}
    parts = [Verdict.ERROR] if errors else []
    if interrupted:
        parts.append(Verdict.INCONCLUSIVE)
    if "failed" in outcomes:
        parts.append(Verdict.FAIL)
    if "passed" in outcomes:
        parts.append(Verdict.PASS)
    return worst(parts)


def _metrics(trials: Sequence[dict[str, Any]], judged: Sequence[dict[str, Any]]) -> dict[str, Any]:
    strict, lenient = (sum(t[key] is True for t in judged) for key in ("success_strict", "success_lenient"))
    n = len(judged)
    return {
        "trials": n,
        "success_rate": lenient / n if n else None,
        "success_rate_strict": strict / n if n else None,
        "success_interval": list(wilson_interval(lenient, n)) if n else None,
        "success_interval_strict": list(wilson_interval(strict, n)) if n else None,
        "realtime_factor": _median(trials, "realtime_factor"),
        "min_clearance_m": min(_numbers(judged, "min_clearance_m"), default=None),
        "duration_s": _median(judged, "duration_s"),
        "determinism_hash": _joint_hash([t.get("determinism_hash") for t in trials]),
    }


def _check(limit: Limit, metrics: dict[str, Any], judged: Sequence[dict[str, Any]]) -> Check:
    if limit.is_rate:
        key = "success_strict" if limit.name == "success_rate_strict" else "success_lenient"
        return check_rate(sum(t[key] is True for t in judged), len(judged), limit)
    unit = METRIC_UNITS.get(limit.name, limit.unit)
    origin = METRIC_ORIGINS.get(limit.name, SIMULATED)
    return check(Measurement(metrics.get(limit.name), unit, origin, len(judged)), limit)


def _outcome(trial: dict[str, Any], live: bool) -> dict[str, Any]:
    keys = (
        "seed",
        "scene",
        "outcome",
        "cause",
        "min_clearance_m",
        "duration_s",
        "part",
        "label",
        "label_reason",
        "path_length_m",
        "path_excess",
        "landed",
        "success_strict",
        "success_lenient",
        "sim_s",
        "wall_s",
        "realtime_factor",
        "determinism_hash",
        "autopilot",
        "timing",
        "link_counters",
        "measures",
        "files",
    )
    return {key: trial.get(key) for key in keys} | {
        "verdict": trial_verdict(trial).value,
        "replay": replay_command(trial["request"], trial["seed"], live),
    }


def _provenance(header: dict[str, Any], trials: Sequence[dict[str, Any]]) -> dict[str, Any]:
    request = header.get("request") or (trials[-1]["request"] if trials else dict.fromkeys(REQUEST_KEYS))
    seen = [t["autopilot"] for t in trials if t.get("autopilot")]
    autopilot = dict(seen[-1]) if seen else {"kind": request["autopilot"], "version": None}
    autopilot["real_firmware"] = autopilot["kind"] != "embedded"
    return {
        "autopilot": autopilot,
        "world": SIMULATED,
        "denoiser": request["denoiser"],
        "weights_sha256": trials[-1].get("weights_sha256") if trials else None,
        "runtime": trials[-1].get("runtime") if trials else None,
        "stack": request["stack"],
        "shield": request["shield"],
        "shield_noise": trials[-1].get("shield_noise") if trials else None,
        "sonar": request["sonar"],
        "faults": request.get("faults", {}),
        "git": header.get("git"),
        "seed": header["seeds"][0] if header.get("seeds") else None,
        "seeds": header.get("seeds", []),
        "versions": header.get("versions"),
        "sha256": header.get("sha256", {}),
        "origin": "simulated flight" + ("" if autopilot["real_firmware"] else ", simulated autopilot"),
    }


def _joint_hash(hashes: Sequence[str | None]) -> str | None:
    """The flight's own hash; of several, one over theirs in order. None when a flight has none."""
    known = [h for h in hashes if h]
    if not known or len(known) != len(hashes):
        return None
    return known[0] if len(known) == 1 else hashlib.sha256("\n".join(known).encode()).hexdigest()


def _numbers(trials: Sequence[dict[str, Any]], key: str) -> list[float]:
    return [float(t[key]) for t in trials if t.get(key) is not None and math.isfinite(t[key])]


def _median(trials: Sequence[dict[str, Any]], key: str) -> float | None:
    values = _numbers(trials, key)
    return median(values) if values else None
