"""A sweep, or several read as one, in numbers: the object that --json prints and the page is made from."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bench.procedures.analysis import Analysis, analyse, band_of, fits_of, headline, hover_of, repeatability_db
from bench.procedures.fits import Points
from bench.procedures.hover import READINGS_KGF, STANDARD_GRAVITY_M_S2
from bench.procedures.plan import Condition
from bench.procedures.points import Point, SweepRecord, points_of, worst_origin
from bench.procedures.prediction import predicted_ranges, thresholds
from bench.procedures.schedule import plan_hash, schedule
from bench.verdict import Check, Limit, Measurement, Verdict, check, load_limits, worst
from saranga.errors import UsageError

CURVE_POINTS = 40


def summarise_sweeps(sweeps: Sequence[SweepRecord], target_kgf: float | None = None,
                     sensor: str | None = None) -> dict[str, Any]:
    """Results, checks and verdict.

    Args:
        sweeps: from `read_sweep`, each with its own number.
        target_kgf: thrust of one motor that losses are quoted at [0.115 kgf, hover].
        sensor: role [that of the first plan].

    Returns:
        JSON-ready but for "analysis", which is taken out before it is written.

    Raises:
        UsageError: conditions of one name that are not the same thing, or nothing measured.
    """
    target = READINGS_KGF["one_motor"] if target_kgf is None else target_kgf
    if not (math.isfinite(target) and target > 0.0):
        raise UsageError(f"--at-thrust {target}: must be a positive number of kgf")
    role = sensor or sweeps[0].plan.rig.sensor
    conditions = merged_conditions(sweeps)
    points = [p for s in sweeps for p in points_of(s)]
    sensors = sorted({p.sensor for p in points})
    if points and role not in sensors:
        raise UsageError(f"no noise of sensor {role!r} in it: it has {', '.join(sensors)}")
    analysis = analyse(points, conditions, role, target)
    origin = worst_origin(s.origin for s in sweeps)
    metrics = _metrics(sweeps, points, analysis, role)
    checks = _checks(metrics, origin, analysis)
    states = [(s.records.end or {}).get("state", "cut off") for s in sweeps]
    errors = [str(s.records.of("error")[-1]["error"]) for s, state in zip(sweeps, states, strict=True)
              if state in ("failed", "crashed") and s.records.of("error")]
    verdicts = [c.verdict for c in checks]
    if any(state in ("crashed", "failed", "cut off") for state in states):
        verdicts.append(Verdict.ERROR)
    elif "interrupted" in states:
        verdicts.append(Verdict.INCONCLUSIVE)
    best = _shield_verdict(checks)
    evidence = [v for v, c in zip(verdicts, checks, strict=False) if not c.name.startswith("insertion_loss_db")]
    overall = worst([*evidence, *verdicts[len(checks):], *([best] if best else [])])
    return {
        "verdict": overall.value, "kind": "sweep", "origin": origin, "state": states[-1], "errors": errors,
        "sensor": role, "sensors": sensors, "target_kgf": target,
        "points": [_point(p) for p in points],
        "insertion_loss_db": {name: _loss(analysis, name) for name in analysis.losses},
        "comparisons": [{"one": d.one, "other": d.other, "value": d.estimate.value, "interval": d.estimate.interval,
                         "answer": d.answer, "blocks_needed": d.blocks_needed, "sentence": d.sentence}
                        for d in analysis.differences],
        "optimum_height": None if analysis.height is None else {
            "height_m": analysis.height.optimum_m, "by_height": {f"{h:g}": a for h, a in
                                                                 analysis.height.by_height.items()},
            "sentence": analysis.height.sentence},
        "hover": hover_of(analysis.curves),
        "fits": {name: fits_of(blocks) for name, blocks in analysis.curves.items() if blocks},
        "curves": {name: _curves(blocks) for name, blocks in analysis.curves.items() if blocks},
        "repeatability_db": repeatability_db(analysis), "drift_db": {str(b): d for b, d in analysis.drift_db.items()},
        "other_sensors": {s: _others(points, conditions, s, target) for s in sensors if s != role},
        "prediction": _prediction(analysis), "spectra": _spectra(sweeps, role), "coherence": _coherence(sweeps),
        "checks": [c.to_dict() for c in checks], "metrics": metrics, "outcomes": [],
        "conditions": [c.model_dump(mode="json") for c in conditions], "reference": analysis.reference,
        "analysis": analysis, "provenance": provenance(sweeps), "run": str(sweeps[-1].folder),
        "runs": [str(s.folder) for s in sweeps]}


def merged_conditions(sweeps: Sequence[SweepRecord]) -> tuple[Condition, ...]:
    """The conditions of all plans by name.

    Raises:
        UsageError: one name for two different things.
    """
    found: dict[str, Condition] = {}
    for s in sweeps:
        for c in s.plan.conditions:
            known = found.setdefault(c.name, c)
            if _thing(known) != _thing(c):
                raise UsageError(f"condition {c.name!r} is not the same in {sweeps[0].folder} and {s.folder} "
                                 f"({known.shield} and {c.shield}): compare runs of the same shields, or rename one")
    return tuple(found.values())


def _thing(c: Condition) -> tuple[Any, ...]:
    return c.shield, c.reference, c.propeller, c.height_m, c.width_m, c.hub_distance_m


def provenance(sweeps: Sequence[SweepRecord]) -> dict[str, Any]:
    """Devices, plans, hashes, versions, metadata of each run."""
    out = []
    for s in sweeps:
        header = s.records.header
        devices = s.records.of("devices")
        out.append({
            "run": str(s.folder), "plan": s.plan.name, "plan_hash": header.get("plan_hash"), "seed": s.plan.seed,
            "origin": s.origin, "utc": header.get("utc"), "versions": header.get("versions"), "git": header.get("git"),
            "rig": devices[-1].get("rig") if devices else None, "stand": devices[-1].get("stand") if devices else None,
            "metadata": s.plan.metadata, "air": next((e.get("air") for e in reversed(devices) if e.get("air")), None),
            "counters": (s.records.of("counters") or [{}])[-1].get("counters"), "resumed": len(devices) > 1,
            "stop": (s.records.of("stopped") or [{}])[-1].get("report")})
    return {"runs": out, "plan_hash_now": plan_hash(sweeps[0].plan)}


def _metrics(sweeps: Sequence[SweepRecord], points: list[Point], analysis: Analysis, role: str) -> dict[str, Any]:
    planned = sum(len(schedule(s.plan)) for s in sweeps)
    steps = [step for s in sweeps for step in s.steps]
    mine = [p for p in points if p.sensor == role]
    spinning = [s for s in steps if s["phase"] != "background"]
    losses = [headline(x)[0].half_width for x in analysis.losses.values() if x is not None]
    counters = [c for s in sweeps for r in s.records.of("counters") for c in [r.get("counters") or {}]]
    cycles = sum(c.get("cycle_cycles", 0) for c in counters)
    lost = sum(c.get("cycle_missing", 0) + c.get("cycle_incomplete", 0) for c in counters)
    return {
        "steps": len(steps), "steps_planned": planned, "steps_done_share": len(steps) / planned if planned else None,
        "settled_share": _share([bool(s["settled"]) for s in spinning]),
        "clipped_share": max((p.clipped_share for p in mine), default=None),
        "usable_share": _share([p.usable for p in mine]),
        "drift_db": max((abs(d) for d in analysis.drift_db.values()), default=None),
        "blocks": min((len(b) for b in analysis.curves.values()), default=0),
        "half_width_db": (max(losses) if math.isfinite(max(losses)) else None) if losses else None,
        "lost_share": lost / (cycles + lost) if cycles + lost else None}


def _checks(metrics: dict[str, Any], origin: str, analysis: Analysis) -> list[Check]:
    found = []
    for limit in load_limits("sweep"):
        absent = metrics.get(limit.name) is None
        if absent and limit.name in ("half_width_db", "drift_db") and not analysis.losses:
            continue  # the plan compares nothing to a reference
        if absent and limit.name in ("drift_db", "half_width_db"):
            found.append(_check(limit, Verdict.INCONCLUSIVE, None, "not measured in this sweep", origin))
            continue
        found.append(check(Measurement(metrics.get(limit.name), limit.unit, origin), limit))
    for limit in load_limits("shields", known_metrics=("insertion_loss_db",)):
        found += [_loss_check(limit, name, analysis, origin) for name in analysis.losses]
    return found


def _loss_check(limit: Limit, name: str, analysis: Analysis, origin: str) -> Check:
    loss = analysis.losses[name]
    title = f"insertion_loss_db of {name}"
    if loss is None:
        return _check(limit, Verdict.INCONCLUSIVE, None, analysis.loss_notes.get(name, "not measured"), origin, title)
    estimate, where = headline(loss)
    assert limit.lo is not None
    if estimate.low is None or estimate.high is None:
        return _check(limit, Verdict.INCONCLUSIVE, estimate.value, f"{where}: one block gives no interval", origin,
                      title)
    seen = f"{estimate.value:.2f} dB ({estimate.low:.2f} to {estimate.high:.2f}), {origin}, {where}"
    if limit.requires == "measured" and origin != "measured":
        verdict = Verdict.INCONCLUSIVE
    elif estimate.low >= limit.lo:
        verdict = Verdict.PASS
    elif estimate.high < limit.lo:
        verdict = Verdict.FAIL
    else:
        verdict = Verdict.INCONCLUSIVE
    return _check(limit, verdict, estimate.value, seen, origin, title, (estimate.low, estimate.high))


def _check(limit: Limit, verdict: Verdict, value: float | None, why: str, origin: str, name: str | None = None,
           interval: tuple[float, float] | None = None) -> Check:
    return Check(name or limit.name, verdict, value, limit.unit, limit.text, why, origin, interval, None, limit.reason,
                 limit.source)


def _shield_verdict(checks: Sequence[Check]) -> Verdict | None:
    """A comparison is to find a shield that is good enough: one is enough, so the best of them counts."""
    mine = [c.verdict for c in checks if c.name.startswith("insertion_loss_db")]
    order = (Verdict.PASS, Verdict.MARGINAL, Verdict.INCONCLUSIVE, Verdict.FAIL, Verdict.ERROR)
    return min(mine, key=order.index) if mine else None


def _loss(analysis: Analysis, name: str) -> dict[str, Any]:
    loss = analysis.losses[name]
    if loss is None:
        return {"value": None, "interval": None, "why": analysis.loss_notes.get(name, "not measured")}
    estimate, where = headline(loss)
    return {"value": estimate.value, "interval": estimate.interval, "blocks": estimate.blocks, "where": where,
            "deviation": estimate.deviation,
            "overall": {"value": loss.overall.value, "interval": loss.overall.interval},
            "per_block": {str(b): v for b, v in loss.per_block.items()},
            "thrust_n": list(loss.thrust_n), "at": [e.value for e in loss.at],
            "low": [e.low for e in loss.at], "high": [e.high for e in loss.at]}


def _prediction(analysis: Analysis) -> dict[str, Any]:
    """Detection ranges, shield by shield; the unshielded reference first."""
    ranges: dict[str, Any] = {}
    if analysis.reference is not None:
        ranges[analysis.reference] = predicted_ranges(0.0, 0.0, 0.0)
    for name, loss in analysis.losses.items():
        if loss is not None:
            e = headline(loss)[0]
            ranges[name] = predicted_ranges(e.value, e.low, e.high)
    return {"ranges_m": ranges, "thresholds": [{"name": t.name, "psnr_db": t.psnr_db, "source": t.source}
                                               for t in thresholds()] if ranges else [],
            "origin": "simulated: sonar equation anchored on the paper, fed with the losses above"}


def _others(points: Sequence[Point], conditions: tuple[Condition, ...], sensor: str, target: float) -> dict[str, Any]:
    analysis = analyse(points, conditions, sensor, target)
    return {"insertion_loss_db": {name: {k: v for k, v in _loss(analysis, name).items() if k in ("value", "interval")}
                                  for name in analysis.losses}}


def _curves(blocks: dict[int, Points]) -> dict[str, Any]:
    good = [p for p in blocks.values() if len(p)]
    if not good:
        return {}
    thrust = np.linspace(min(p.thrust_n[0] for p in good), max(p.thrust_n[-1] for p in good), CURVE_POINTS)
    out: dict[str, Any] = {"thrust_n": thrust.tolist()}
    for kind in ("quadratic", "power_law"):
        band = band_of(kind, blocks, thrust.tolist())
        if band:
            out[kind] = {"rms": [10 ** (e.value / 20) for e in band],
                         "low": None if band[0].low is None else [10 ** ((e.low or 0.0) / 20) for e in band],
                         "high": None if band[0].high is None else [10 ** ((e.high or 0.0) / 20) for e in band]}
    return out


def _spectra(sweeps: Sequence[SweepRecord], role: str) -> dict[str, Any]:
    """Mean spectrum and fast-time correlation of each condition's loudest half of steps, and of the background."""
    out: dict[str, Any] = {}
    for s in sweeps:
        groups: dict[str, list[dict[str, Any]]] = {}
        for step in s.steps:
            noise = step["noise"].get(role)
            if noise and noise["spectrum"]:
                name = "background" if step["phase"] == "background" else step["condition"]
                groups.setdefault(name, []).append(noise)
        for name, members in groups.items():
            if name in out:
                continue
            loud = sorted(members, key=lambda n: n["rms"])[len(members) // 2:]
            out[name] = {"rate_hz": loud[0]["rate_hz"],
                         "power": np.mean([n["spectrum"] for n in loud], axis=0).tolist(),
                         "correlation": np.mean([n["correlation"] for n in loud], axis=0).tolist()}
    return out


def _coherence(sweeps: Sequence[SweepRecord]) -> dict[str, Any]:
    found: dict[str, list[float]] = {}
    floor = None
    for s in sweeps:
        for step in s.steps:
            if step.get("coherence") is not None:
                name = "background" if step["phase"] == "background" else step["condition"]
                found.setdefault(name, []).append(step["coherence"])
                floor = 1.0 / max(step["coherence_segments"], 1)
    return {"by_condition": {n: float(np.mean(v)) for n, v in found.items()}, "independent_noise": floor}


def _point(p: Point) -> dict[str, Any]:
    return {"run": p.run, "step": p.step, "block": p.block, "condition": p.condition, "shield": p.shield,
            "phase": p.phase, "sensor": p.sensor, "throttle": p.throttle, "thrust_n": p.thrust_n,
            "thrust_kgf": p.thrust_n / STANDARD_GRAVITY_M_S2, "noise_rms": p.rms, "raw_rms": p.raw_rms,
            "margin_db": p.margin_db if math.isfinite(p.margin_db) else None, "treatment": p.treatment,
            "usable": p.usable, "clipped_share": p.clipped_share, "settled": p.settled}


def _share(flags: list[bool]) -> float | None:
    return sum(flags) / len(flags) if flags else None


def source_text(sweep: SweepRecord) -> str:
    """One line for people: run, date, propeller, sensor."""
    devices = sweep.records.of("devices")
    rig = (devices[-1].get("rig") or {}) if devices else {}
    serial = next((s["serial"] for s in rig.get("sensors", []) if s["role"] == sweep.plan.rig.sensor), "unknown")
    propeller = sweep.plan.metadata.get("propeller", "propeller not stated")
    return (f"run {Path(sweep.folder).name}, {str(sweep.records.header.get('utc', ''))[:10]}, {propeller}, "
            f"sensor {sweep.plan.rig.sensor} {serial}, plan {sweep.plan.name}, {sweep.origin}")
