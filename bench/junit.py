"""JUnit XML of a run of flights, made from its summary, for CI that reads nothing else."""

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from bench.verdict import Verdict


def write_junit(path: Path, summary: dict[str, Any]) -> Path:
    """One test case a flight and one a limit; ERROR is an error, FAIL and INCONCLUSIVE are failures."""
    cases = [
        _case(
            "flight",
            f"{o['scene']}[seed {o['seed']}]",
            o["verdict"],
            f"{o['outcome']}: {o['cause']}",
            o.get("wall_s"),
            {k: o.get(k) for k in ("seed", "min_clearance_m", "determinism_hash", "replay")},
        )
        for o in summary["outcomes"]
    ]
    cases += [
        _case(
            "limit",
            f"{c['name']} {c['limit']}",
            c["verdict"],
            c["why"],
            None,
            {"value": c["value"], "reason": c["reason"], "source": c["source"]},
        )
        for c in summary["checks"]
    ]
    cases += [_case("run", f"error {n}", "ERROR", text, None, {}) for n, text in enumerate(summary["errors"], 1)]
    if summary["interrupted"]:
        text = f"cut short: {len(summary['outcomes'])} of {summary['trials_planned']} flights"
        cases.append(_case("run", "complete", "INCONCLUSIVE", text, None, {}))
    suite = ElementTree.Element(
        "testsuite",
        name="saranga-bench fly",
        tests=str(len(cases)),
        errors=str(sum(c.find("error") is not None for c in cases)),
        failures=str(sum(c.find("failure") is not None for c in cases)),
    )
    provenance = summary["provenance"]
    _properties(
        suite,
        {
            "verdict": summary["verdict"],
            "run": summary["run"],
            "origin": provenance["origin"],
            "autopilot": "{kind} {version}".format(**provenance["autopilot"]),
            "git": (provenance["git"] or {}).get("commit"),
        },
    )
    suite.extend(cases)
    root = ElementTree.Element("testsuites")
    root.append(suite)
    ElementTree.indent(root)
    ElementTree.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
    return path


def _case(
    group: str, name: str, verdict: str, text: str, seconds: float | None, properties: dict[str, Any]
) -> ElementTree.Element:
    case = ElementTree.Element("testcase", classname=f"saranga.{group}", name=_clean(name))
    if seconds is not None:
        case.set("time", f"{seconds:.3f}")
    _properties(case, {"verdict": verdict, **properties})
    if not Verdict(verdict).accepted:
        kind = "error" if verdict == Verdict.ERROR else "failure"
        ElementTree.SubElement(case, kind, message=_clean(f"{verdict}: {text}"))
    return case


def _properties(parent: ElementTree.Element, values: dict[str, Any]) -> None:
    properties = ElementTree.SubElement(parent, "properties")
    for name, value in values.items():
        if value is not None:
            ElementTree.SubElement(properties, "property", name=name, value=_clean(str(value)))


def _clean(text: str) -> str:
    """Without the control characters that XML cannot carry."""
    return "".join(c if c >= " " or c in "\t\n" else "?" for c in text)
