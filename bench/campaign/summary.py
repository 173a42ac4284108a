"""The table of a campaign, from its journal alone."""

from collections import Counter
from datetime import datetime
from pathlib import Path
from statistics import mean, median, pstdev
from typing import Any

from bench.baseline.flights import Pairs
from bench.baseline.verdict import compare
from bench.campaign.behaviour import Acceptable, behaviour_of, judge_row
from bench.campaign.screening import screening_of
from bench.flight_summary import NOT_JUDGED, replay_command, trial_verdict
from bench.journal import FILE_NAME, Records, read_journal
from bench.paper_verdict import paper_verdict
from bench.statistics import mcnemar_exact, wilson_interval
from bench.store import write_json
from bench.verdict import SIMULATED, Verdict, worst
from saranga.errors import UsageError

SUMMARY_FILE = "summary.json"
OUTCOME_KEYS = ("outcome", "cause", "label", "label_reason", "success_strict", "success_lenient", "min_clearance_m",
                "duration_s", "path_length_m", "path_excess", "realtime_factor", "wall_s", "sim_s",
                "determinism_hash", "autopilot", "measures")
KEYS = {"strict": "success_strict", "lenient": "success_lenient"}

Trial = dict[str, Any]


def rebuild_campaign(folder: Path) -> dict[str, Any]:
    """Make `summary.json` anew from the journal; returns it.

    Raises:
        UsageError: no readable journal of a campaign.
    """
    summary = summarise_campaign(read_journal(folder / FILE_NAME), folder)
    summary["run"] = str(folder)
    write_json(folder / SUMMARY_FILE, summary)
    return summary


def summarise_campaign(journal: Records, folder: Path | None = None) -> dict[str, Any]:
    """See `rebuild_campaign`; a trial flown twice counts as it ended last. `folder` holds the tracks."""
    header = journal.header
    if header.get("run_kind") != "campaign":
        raise UsageError("that journal is not one of a campaign")
    suite = header["suite"]
    last: dict[tuple[str, int], dict[str, Any]] = {(r["row"], r["seed"]): r for r in journal.of("trial")}
    order = {row["name"]: k for k, row in enumerate(suite["row"])}
    outcomes = [_outcome(r) for _, r in sorted(last.items(), key=lambda item: (order.get(item[0][0], 99), item[0][1]))]
    held = {row["name"]: Acceptable.model_validate(row["acceptable"]) for row in suite["row"] if row.get("acceptable")}
    for trial in outcomes:
        if trial["row"] in held:
            trial["verdict"] = _fault_verdict(held[trial["row"]], trial).value
    rows = [_row(row, suite["suite"], [t for t in outcomes if t["row"] == row["name"]], held.get(row["name"]))
            for row in suite["row"]]
    comparisons = [_comparison(c, outcomes) for c in suite.get("comparison", [])]
    rules = {row["name"]: row.get("rule", "strict") for row in suite["row"]}
    screening = screening_of(suite.get("screening", []), rules, outcomes, folder)
    errors = [r["error"] for r in journal.of("error")]
    errors += [f"{t['row']} seed {t['seed']}: {t['cause']}" for t in outcomes if t["outcome"] == "infrastructure"
               and not (t["row"] in held and t["behaviour"] != "broken")]
    if journal.damaged_lines:
        errors.append(f"journal lines {journal.damaged_lines} cannot be read")
    planned = sum(row["planned"] for row in rows)
    interrupted = journal.end is None or journal.end["state"] == "interrupted" or len(outcomes) < planned
    parts = [Verdict(row["verdict"]) for row in rows] + [Verdict(c["verdict"]) for c in comparisons]
    if screening is not None:
        parts.append(Verdict(screening["verdict"]))
    if interrupted:
        parts.append(Verdict.INCONCLUSIVE)
    if errors:
        parts.append(Verdict.ERROR)
    return {
        "verdict": worst(parts).value, "suite": {k: suite["suite"][k] for k in ("name", "description")}, "rows": rows,
        "comparisons": comparisons, "outcomes": outcomes, "metrics": _metrics(journal, outcomes, rows, planned),
        "provenance": _provenance(header, outcomes), "run": header.get("run"), "interrupted": interrupted,
        "errors": errors, "warnings": [r["text"] for r in journal.of("warning")], "screening": screening,
    }


def _outcome(record: dict[str, Any]) -> Trial:
    result = record.get("result")
    if result is None:
        result = dict.fromkeys(OUTCOME_KEYS) | {
            "outcome": "infrastructure", "cause": record.get("error") or "no result", "label": "infrastructure",
            "label_reason": record.get("error") or "", "success_strict": False, "success_lenient": False}
    return {"row": record["row"], "seed": record["seed"], "scene": record["request"]["scene"],
            **{key: result.get(key) for key in OUTCOME_KEYS}, "traversability": record.get("traversability"),
            "worker": record.get("worker"), "memory_mb": record.get("memory_mb"),
            "weights_sha256": result.get("weights_sha256"), "runtime": result.get("runtime"),
            "verdict": trial_verdict(result).value, "behaviour": behaviour_of(result),
            "replay": replay_command(record["request"], record["seed"]),
            "files": record.get("files", {})}


def _fault_verdict(acceptable: Acceptable, trial: Trial) -> Verdict:
    """Of one flight with a fault planted; the row has the last word."""
    if trial["outcome"] == "interrupted":
        return Verdict.INCONCLUSIVE
    alone = judge_row(acceptable.model_copy(update={"touched_at_most": None}), [trial], 1).verdict
    allowed = alone is Verdict.FAIL and trial["behaviour"] == "touched" and acceptable.touched_at_most is not None
    return Verdict.MARGINAL if allowed else alone


def _row(row: dict[str, Any], head: dict[str, Any], trials: list[Trial], acceptable: Acceptable | None
         ) -> dict[str, Any]:
    judged = [t for t in trials if t["outcome"] not in NOT_JUDGED]
    rule = row.get("rule", "strict")
    planned = row.get("trials") or head["trials"]
    if acceptable is None:
        verdict, reason, needed, sprt = _row_verdict(row, rule, trials, judged, planned)
    else:
        judged = [t for t in trials if t["outcome"] != "interrupted" and t["behaviour"] != "broken"]
        did = judge_row(acceptable, [t for t in trials if t["outcome"] != "interrupted"], planned)
        verdict, reason, needed, sprt = did.verdict, did.reason, did.trials_needed, None
    courses = _numbers(trials, "traversability")
    paper = row.get("paper")
    return {
        "name": row["name"], "scene": row["scene"], "stack": row.get("stack") or head["stack"],
        "sonar": row.get("sonar") or head.get("sonar"), "denoiser": row.get("denoiser") or head["denoiser"],
        "rule": rule, "trials": len(judged), "planned": planned,
        "paper": None if paper is None else {
            **paper, "traversability": paper.get("traversability"), "rate": paper["successes"] / paper["trials"],
            "interval": list(wilson_interval(paper["successes"], paper["trials"]))},
        **{name: _rate(judged, key) for name, key in KEYS.items()},
        "verdict": verdict.value, "reason": reason, "trials_needed": needed, "sprt": sprt,
        "traversability": None if not courses else {
            "mean": mean(courses), "std": pstdev(courses), "paper": (paper or {}).get("traversability")},
        "outcomes": dict(Counter(t["outcome"] for t in trials)),
        "labels": dict(Counter(t["label"] for t in trials if t["label"])),
        "faults": row.get("faults") or {}, "acceptable": row.get("acceptable"),
        "behaviours": dict(Counter(t["behaviour"] for t in trials)) if acceptable is not None else None,
        "realtime_factor": _median(trials, "realtime_factor"),
        "min_clearance_m": min(_numbers(judged, "min_clearance_m"), default=None),
        "duration_s": _median(judged, "duration_s"), "path_excess": _median(judged, "path_excess"),
    }


def _row_verdict(row: dict[str, Any], rule: str, trials: list[Trial], judged: list[Trial], planned: int
                 ) -> tuple[Verdict, str, int | None, dict[str, Any] | None]:
    broken = sum(t["outcome"] == "infrastructure" for t in trials)
    if broken:
        return Verdict.ERROR, f"{broken} of {len(trials)} trials broke off: the evidence is not whole", None, None
    good = [t[KEYS[rule]] is True for t in judged]
    if row.get("paper") is not None:
        held = paper_verdict(good, row["paper"]["successes"], row["paper"]["trials"])
        return held.verdict, held.reason, held.trials_needed, held.sprt
    if len(judged) < planned:
        return Verdict.INCONCLUSIVE, f"{len(judged)} of {planned} trials flown", planned - len(judged), None
    return Verdict.PASS, f"{sum(good)} of {len(good)}; the paper has no rate to hold it to", None, None


def _comparison(comparison: dict[str, Any], outcomes: list[Trial]) -> dict[str, Any]:
    """McNemar over the seeds that both rows flew, or the regression verdict."""
    if comparison["expect"] == "regression":
        return _regression(comparison, outcomes)
    key = KEYS[comparison["rule"]]
    sides = [{t["seed"]: t[key] is True for t in outcomes
              if t["row"] == comparison[side] and t["outcome"] not in NOT_JUDGED} for side in ("a", "b")]
    seeds = sorted(set(sides[0]) & set(sides[1]))
    only_a = sum(sides[0][s] and not sides[1][s] for s in seeds)
    only_b = sum(sides[1][s] and not sides[0][s] for s in seeds)
    p = mcnemar_exact(only_a, only_b)
    direction = "a_better" if only_a > only_b else "b_better" if only_b > only_a else "equal"
    wanted = comparison["expect"]
    small = p < comparison["p_below"]
    seen = f"{only_a} seeds only {comparison['a']}, {only_b} only {comparison['b']}, of {len(seeds)} pairs: p = {p:.2g}"
    if small and (wanted == "different" or direction == wanted):
        verdict, reason = Verdict.PASS, seen
    elif small:
        verdict, reason = Verdict.FAIL, f"{seen}, and the other way round"
    else:
        verdict, reason = Verdict.INCONCLUSIVE, f"{seen}; {comparison['p_below']:g} was asked for"
    return {**{k: comparison[k] for k in ("name", "a", "b", "rule", "expect")}, "pairs": len(seeds), "only_a": only_a,
            "only_b": only_b, "p_value": p, "verdict": verdict.value, "reason": reason}


def _regression(comparison: dict[str, Any], outcomes: list[Trial]) -> dict[str, Any]:
    """Is b found worse than a by any measure? A worsening that is not found is a FAIL of the bench."""
    a, b = ({t["seed"]: t for t in outcomes if t["row"] == comparison[side] and t["outcome"] not in NOT_JUDGED}
            for side in ("a", "b"))
    seeds = sorted(set(a) & set(b))
    found = compare(Pairs((), tuple(b[s] for s in seeds), tuple(a[s] for s in seeds)))
    verdict = {Verdict.FAIL: Verdict.PASS, Verdict.INCONCLUSIVE: Verdict.INCONCLUSIVE}.get(found.verdict, Verdict.FAIL)
    said = "worse, as it must be" if verdict is Verdict.PASS else "not found to be worse" * (verdict is Verdict.FAIL)
    return {**{k: comparison[k] for k in ("name", "a", "b", "rule", "expect")}, "pairs": len(seeds), "only_a": None,
            "only_b": None, "p_value": None, "verdict": verdict.value,
            "reason": ": ".join(text for text in (said, found.reason) if text)}


def _metrics(journal: Records, outcomes: list[Trial], rows: list[dict[str, Any]], planned: int) -> dict[str, Any]:
    judged = [t for t in outcomes if t["outcome"] not in NOT_JUDGED]
    lenient = _rate(judged, "success_lenient")
    wall_s = _wall_s(journal)
    sessions = journal.of("session")
    workers = sessions[-1]["workers"] if sessions else None
    needed = [row["trials_needed"] for row in rows if row["trials_needed"]]
    memory = _numbers(outcomes, "memory_mb")
    return {
        "trials": sum(row["trials"] for row in rows), "planned": planned, "success_rate": lenient["rate"],
        "success_rate_strict": _rate(judged, "success_strict")["rate"], "success_interval": lenient["interval"],
        "trials_per_hour": len(outcomes) / wall_s * 3600.0 if wall_s else None,
        "aggregate_realtime_factor": sum(_numbers(outcomes, "sim_s")) / wall_s if wall_s else None,
        "realtime_factor": _median(outcomes, "realtime_factor"), "wall_s": wall_s, "workers": workers,
        "memory_mb_per_worker": max(memory, default=None), "determinism_hash": _joint_hash(outcomes),
        "trials_needed": sum(needed) if needed else None,
    }


def _wall_s(journal: Records) -> float:
    """Time in which trials were flown: of every session, killed or not, from its start to its last record."""
    total, began, last = 0.0, None, 0.0
    for record in journal.records:
        now = datetime.fromisoformat(record["utc"]).timestamp()
        if record["kind"] == "session":
            total += last - began if began is not None else 0.0
            began = now
        last = now
    return total + (last - began if began is not None else 0.0)


def _provenance(header: dict[str, Any], outcomes: list[Trial]) -> dict[str, Any]:
    head = header["suite"]["suite"]
    seen = [t["autopilot"] for t in outcomes if t.get("autopilot")]
    autopilot = dict(seen[-1]) if seen else {"kind": head["autopilot"], "version": None}
    autopilot["real_firmware"] = autopilot["kind"] != "embedded"
    return {"autopilot": autopilot, "world": SIMULATED, "denoiser": head["denoiser"], "stack": head["stack"],
            "shield": head["shield"], "weights_sha256": (header.get("weights") or {}).get(head["denoiser"]),
            "git": header.get("git"), "seed": head["seed"], "versions": header.get("versions"),
            "origin": "simulated flight" + ("" if autopilot["real_firmware"] else ", simulated autopilot")}


def _rate(judged: list[Trial], key: str) -> dict[str, Any]:
    successes, n = sum(t[key] is True for t in judged), len(judged)
    return {"successes": successes, "rate": successes / n if n else None,
            "interval": list(wilson_interval(successes, n)) if n else None}


def _joint_hash(outcomes: list[Trial]) -> str | None:
    import hashlib

    hashes = [t["determinism_hash"] for t in outcomes]
    return None if not hashes or not all(hashes) else hashlib.sha256("\n".join(hashes).encode()).hexdigest()


def _numbers(trials: list[Trial], key: str) -> list[float]:
    return [float(t[key]) for t in trials if isinstance(t.get(key), int | float)]


def _median(trials: list[Trial], key: str) -> float | None:
    values = _numbers(trials, key)
    return median(values) if values else None
