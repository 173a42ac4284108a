"""Every check on the evidence: rows for a person and for a script, worst first."""

import math
from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Any

import bench.preflight.checks
from bench.findings import judge_finding
from bench.preflight.evidence import EMULATED, SIMULATED, Evidence, Finding
from bench.rig.check import examine as examine_rig
from bench.verdict import Check, Limit, Verdict, load_limits
from saranga.errors import UsageError
from saranga.plugins import nearest_hint, plugins

AGE_LIMIT = "evidence_age_s"
NOTHING = "nothing"
RIG = "rig"
ORDER = {"ERROR": 0, "FAIL": 1, "INCONCLUSIVE": 2, "MARGINAL": 3, "PASS": 4}
SYMPTOMS = ("ekf", "prearm", "sensors", "messages", "mavsdk")
"""What suffers from the causes that other checks find: listed after them."""
OF_THE_COMPUTER = ("stack", "weights", "computer")


def check_names() -> list[str]:
    """Names of all checks, for --skip."""
    return sorted([*plugins(bench.preflight.checks), RIG])


def known_limits() -> list[str]:
    """Names that the shipped limits file has."""
    return [limit.name for limit in load_limits("preflight")]


def examine(evidence: Evidence, limits: Sequence[Limit], rig_limits: Sequence[Limit],
            skip: Collection[str] = ()) -> list[dict[str, Any]]:
    """Every check, JSON-ready, the worst first; each has value, limit, age, source and next action.

    Raises:
        UsageError: a name to skip that no check has, or limits without `evidence_age_s`.
    """
    known = check_names()
    for name in skip:
        if name not in known:
            raise UsageError(f"--skip {name!r}: no such check{nearest_hint(name, known)}: known are {', '.join(known)}")
    by_name = {limit.name: limit for limit in limits}
    if AGE_LIMIT not in by_name or by_name[AGE_LIMIT].hi is None:
        raise UsageError(f"the limits need {AGE_LIMIT} with at_most: evidence of any age would count without it")
    rows = []
    for name, module in plugins(bench.preflight.checks).items():
        origin = _origin(name, evidence)
        try:
            judged = [_row(name, finding, _judge(finding, by_name, origin), evidence)
                      for finding in module.build()(evidence)]
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
            judged = [_crashed(name, error, origin)]
        rows += judged
    rows += _rig_rows(evidence, list(rig_limits))
    most = by_name[AGE_LIMIT].hi or 0.0
    rows = [_bypassed(_aged(row, most), skip) for row in rows]
    return sorted(rows, key=lambda row: (ORDER[row["verdict"]], row["check"] in SYMPTOMS))


def _origin(name: str, evidence: Evidence) -> str:
    if name in OF_THE_COMPUTER:
        return "measured"
    if name.startswith("rig"):
        return evidence.rig.origin if evidence.rig is not None else "none"
    return evidence.vehicle.origin if evidence.vehicle is not None else "none"


def _judge(finding: Finding, limits: dict[str, Limit], origin: str) -> Check:
    checked = judge_finding(finding, limits, origin)
    if finding.bypassed and checked.verdict.accepted:
        return replace(checked, verdict=Verdict.FAIL, why=finding.bypassed)
    return checked


def _row(name: str, finding: Finding, checked: Check, evidence: Evidence) -> dict[str, Any]:
    row = checked.to_dict()
    known = finding.heard_s is not None and math.isfinite(finding.heard_s)
    age_s = round(max(evidence.now_s - (finding.heard_s or 0.0), 0.0), 2) if known else None
    if finding.bypassed:
        row["why"] = f"BYPASSED: {finding.bypassed}"
    elif finding.seen and not finding.blocked and checked.verdict is not Verdict.ERROR:
        row["why"] = f"{row['why']}: {finding.seen}" if row["why"] else finding.seen
    action = NOTHING if checked.verdict is Verdict.PASS else finding.action
    return {**row, "check": name, "of": finding.of, "age_s": age_s, "seen": finding.seen, "action": action,
            "bypassed": bool(finding.bypassed)}


def _crashed(name: str, error: Exception, origin: str) -> dict[str, Any]:
    """A check that fell over what it was given: that is its answer, and it is not PASS."""
    why = f"the check itself failed on this evidence: {type(error).__name__}: {error}"
    checked = Check(f"{name} (crashed)", Verdict.ERROR, None, "1", "", why, origin)
    return {**checked.to_dict(), "check": name, "of": "", "age_s": None, "seen": "", "bypassed": False,
            "action": "look at vehicle.json in the run folder for values that make no sense, and report this"}


def _rig_rows(evidence: Evidence, limits: list[Limit]) -> list[dict[str, Any]]:
    """The rig's own checks, by their own limits; one open row where there is no rig."""
    rig = evidence.rig
    blank = {"of": "", "seen": "", "bypassed": False, "check": RIG}
    if rig is None:
        why = evidence.why_not("rig")
        none = Check("rig_link", Verdict.INCONCLUSIVE, None, "1", "", why, "none",
                     source="saranga-bench rig check", reason="no echoes, no obstacles seen")
        return [{**none.to_dict(), **blank, "age_s": None, "action": "connect the rig and give --rig URL"}]
    age_s = round(max(evidence.now_s - rig.heard_s, 0.0), 2)
    rows = []
    for row in examine_rig(rig.evidence, limits, rig.origin):
        good = row["verdict"] == Verdict.PASS.value
        action = NOTHING if good else row.pop("cause", "") or "see docs/rig.md, then saranga-bench rig check"
        row.pop("cause", None)
        title = f"rig {row.pop('check')}"
        rows.append({**blank, **row, "check": title, "age_s": age_s, "action": action,
                     "why": row["why"] if good or action in row["why"] else f"{row['why']}: {action}"})
    return rows


def _aged(row: dict[str, Any], most_s: float) -> dict[str, Any]:
    """Old evidence, or evidence of no age, passes nothing."""
    if row["verdict"] not in (Verdict.PASS.value, Verdict.MARGINAL.value):
        return row
    if row["age_s"] is not None and row["age_s"] <= most_s:
        return row
    old = "of unknown age" if row["age_s"] is None else f"{row['age_s']:.0f} s old (limit {most_s:g} s)"
    return {**row, "verdict": Verdict.INCONCLUSIVE.value, "why": f"the evidence is {old}", "action": "run it again"}


def _bypassed(row: dict[str, Any], skip: Collection[str]) -> dict[str, Any]:
    if row["check"] not in skip and not (RIG in skip and row["check"].startswith("rig ")):
        return row
    worst = row["verdict"] in (Verdict.FAIL.value, Verdict.ERROR.value)
    return {**row, "bypassed": True, "verdict": row["verdict"] if worst else Verdict.INCONCLUSIVE.value,
            "why": f"BYPASSED by --skip {row['check']}: {row['why']}", "action": f"leave --skip {row['check']} out"}


def go_text(verdict: Verdict, rows: Sequence[dict[str, Any]], origins: Collection[str]) -> str:
    """"GO" or "NO-GO" with the reasons, in one line."""
    if verdict.accepted:
        remarks = [row for row in rows if row["verdict"] == Verdict.MARGINAL.value]
        kinds = sorted(set(origins) & {SIMULATED, EMULATED})
        rehearsal = f"; a rehearsal: {' and '.join(kinds)} evidence, no vehicle was measured" if kinds else ""
        return f"GO: {len(rows)} checks passed" + (f", {len(remarks)} with a remark" if remarks else "") + rehearsal
    bad = [row for row in rows if row["verdict"] in (Verdict.FAIL.value, Verdict.ERROR.value)]
    bad = bad or [row for row in rows if row["verdict"] == Verdict.INCONCLUSIVE.value]
    more = f"; and {len(bad) - 3} more" if len(bad) > 3 else ""
    return "NO-GO: " + "; ".join(f"{row['name']}: {row['why']}" for row in bad[:3]) + more
