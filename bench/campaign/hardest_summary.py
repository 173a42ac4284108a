"""What a search for the hardest course found, from its journal and the courses it kept."""

from pathlib import Path
from typing import Any

from bench.campaign.agreement import independent_difference
from bench.campaign.hardest import COURSES, RUN_KIND
from bench.flight_summary import NOT_JUDGED
from bench.journal import FILE_NAME, Records, read_journal
from bench.statistics import wilson_interval
from bench.store import write_json
from bench.verdict import SIMULATED, Verdict
from saranga.errors import UsageError

SUMMARY_FILE = "summary.json"
SCENE_FILE = "hardest.toml"


def rebuild_hardest(folder: Path) -> dict[str, Any]:
    """Make `summary.json` and the regression scene `hardest.toml` anew; returns the summary.

    The verdict is about the search, not about the stack: PASS when the course is worse than the family over fresh
    seeds (95 % interval), INCONCLUSIVE when that is not shown or flights are missing, ERROR when flights broke off.

    Raises:
        UsageError: no readable journal of a search.
    """
    journal = read_journal(folder / FILE_NAME)
    if journal.header.get("run_kind") != RUN_KIND:
        raise UsageError(f"{folder}: that run is not a search for the hardest course")
    summary = _summarise(journal, folder)
    if summary["found"] is not None:
        key = summary["found"]["course"]["key"]
        course = (folder / COURSES / f"{key}.toml").read_text(encoding="utf-8")
        (folder / SCENE_FILE).write_text(f"{_comment(summary)}\n{course}", encoding="utf-8")
    write_json(folder / SUMMARY_FILE, summary)
    return summary


def _summarise(journal: Records, folder: Path) -> dict[str, Any]:
    asked = journal.header["asked"]
    flights = {(r["course"], r["seed"]): r for r in journal.of("flight")}
    judged = [r for r in flights.values() if r["result"] is not None and r["result"]["outcome"] not in NOT_JUDGED]
    ends = journal.of("found")
    found = ends[-1] if ends else None
    errors = [r["error"] for r in journal.of("error")]
    errors += [f"{r['course']} seed {r['seed']}: {(r['result'] or {}).get('cause') or r['error']}"
               for r in flights.values() if r not in judged]
    interrupted = journal.end is None or journal.end["state"] == "interrupted"
    result = None if found is None else _result(found)
    if errors:
        verdict, reason = Verdict.ERROR, f"{len(errors)} errors: the evidence is not whole"
    elif result is None or interrupted:
        verdict, reason = Verdict.INCONCLUSIVE, "the search did not come to its end"
    elif result["difference"]["interval"][1] < 0.0:
        verdict, reason = Verdict.PASS, f"a harder course was found: {result['text']}"
    else:
        verdict, reason = Verdict.INCONCLUSIVE, f"not shown to be harder: {result['text']}"
    walls = [r["result"]["wall_s"] for r in judged]
    kind = asked["request"]["autopilot"]
    return {
        "verdict": verdict.value, "reason": reason, "scene": asked["request"]["scene"], "asked": asked,
        "found": result, "scene_file": str(folder / SCENE_FILE) if result is not None else None,
        "interrupted": interrupted, "errors": errors, "warnings": [r["text"] for r in journal.of("warning")],
        "metrics": {"flights": len(judged), "budget": asked["budget"], "flight_wall_s": sum(walls)},
        "flights": [_flight(r, asked["rule"]) for r in judged], "run": str(folder),
        "provenance": {"autopilot": {"kind": kind, "real_firmware": kind != "embedded"}, "world": SIMULATED,
                       "git": journal.header.get("git"), "weights": journal.header.get("weights"),
                       "sources": journal.header.get("sources"), "origin": "simulated flight"
                       + ("" if kind != "embedded" else ", simulated autopilot")},
    }


def _flight(record: dict[str, Any], rule: str) -> dict[str, Any]:
    result = record["result"]
    return {"stage": record["stage"], "course": record["course"], "seed": record["seed"], "outcome": result["outcome"],
            "label": result.get("label"), "success": result[f"success_{rule}"] is True, "files": record["files"],
            "min_clearance_m": result.get("min_clearance_m"), "determinism_hash": result.get("determinism_hash")}


def _result(found: dict[str, Any]) -> dict[str, Any]:
    fresh, family = found["fresh"], found["family"]
    out = {key: found[key] for key in ("course", "target", "drawn", "moves")}
    flights, failures = found["chosen_by"]
    out["chosen_by"] = {"flights": flights, "failures": failures}
    for name, values in (("fresh", fresh), ("family", family)):
        out[name] = {"successes": sum(values), "trials": len(values), "rate": sum(values) / len(values),
                     "interval": list(wilson_interval(sum(values), len(values)))}
    difference = independent_difference(sum(fresh), len(fresh), sum(family), len(family))
    out["difference"] = {"value": difference.value, "interval": [difference.low, difference.high]}
    out["text"] = (
        f"{sum(fresh)} of {len(fresh)} on the course, {sum(family)} of {len(family)} on fresh courses of the family: "
        f"{100 * difference.value:+.0f} points ({100 * difference.low:+.0f} to {100 * difference.high:+.0f}), fresh "
        "seeds")
    return out


def _comment(summary: dict[str, Any]) -> str:
    found, request = summary["found"], summary["asked"]["request"]
    lines = [f"Hardest course that a search of {summary['metrics']['flights']} flights found in the family of "
             f"{summary['scene']}", f"(course {found['course']['key']}, first seed {request['seed']}, "
             f"{request['autopilot']}, stack {request['stack']}, denoiser {request['denoiser']}).",
             f"{found['text']}.",
             f"Traversability {found['course']['traversability']:.1f}, the family's {found['target']:.1f}. Geometry is "
             "fixed; the seed sets noise and wind."]
    return "\n".join(f"# {line}" for line in lines)


def hardest_text(summary: dict[str, Any]) -> str:
    """For the terminal."""
    lines = []
    found = summary["found"]
    if found is not None:
        lines += [f"course {found['course']['key']} of {summary['scene']}: traversability "
                  f"{found['course']['traversability']:.1f}, the family's {found['target']:.1f}",
                  f"{found['text']}",
                  f"it was chosen by {found['chosen_by']['failures']} failures in {found['chosen_by']['flights']} "
                  f"flights, which count for nothing here; {found['moves'][1]} of {found['moves'][0]} moved courses "
                  "took the place of the one before",
                  f"saranga-bench fly {summary['scene_file']} --trials 20"]
    return "\n".join([*lines, "", f"{summary['metrics']['flights']} flights; {summary['provenance']['origin']}",
                      f"{summary['verdict']}   {summary['reason']}", summary["run"]])
