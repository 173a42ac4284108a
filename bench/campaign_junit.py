"""A campaign as JUnit: a suite a row, a case a trial and one for the row's own verdict."""

import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

from bench.verdict import Verdict

_NOT_XML = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd]")


def write_campaign_junit(path: Path, summary: dict[str, Any]) -> None:
    """Write it whole or not at all. A trial that is not PASS is a failure, an error or skipped, never green."""
    root = ET.Element("testsuites", name=_clean(summary["suite"]["name"]))
    for row in summary["rows"]:
        suite = ET.SubElement(root, "testsuite", name=_clean(row["name"]))
        trials = [t for t in summary["outcomes"] if t["row"] == row["name"]]
        for trial in trials:
            case = ET.SubElement(suite, "testcase", classname=_clean(row["name"]), name=f"seed {trial['seed']}",
                                 time=f"{trial.get('wall_s') or 0.0:.3f}")
            text = f"{trial.get('label')}: {trial.get('label_reason') or trial.get('cause')}\n{trial['replay']}"
            _mark(case, Verdict(trial["verdict"]), str(trial["outcome"]), text)
        case = ET.SubElement(suite, "testcase", classname=_clean(row["name"]), name="rate")
        _mark(case, Verdict(row["verdict"]), row["verdict"], row["reason"])
        _count(suite)
    screening = summary["screening"]
    others = [("screening", "embedded against real", screening)] if screening is not None else []
    others += [(c["name"], "comparison", c) for c in summary["comparisons"]]
    for title, name, judged in others:
        suite = ET.SubElement(root, "testsuite", name=_clean(title))
        case = ET.SubElement(suite, "testcase", classname=_clean(title), name=name)
        _mark(case, Verdict(judged["verdict"]), judged["verdict"], judged["reason"])
        _count(suite)
    part = path.with_name(path.name + ".part")
    ET.ElementTree(root).write(part, encoding="utf-8", xml_declaration=True)
    part.replace(path)


def _count(suite: ET.Element) -> None:
    for name, tag in (("failures", "failure"), ("errors", "error"), ("skipped", "skipped")):
        suite.set(name, str(len(suite.findall(f"testcase/{tag}"))))
    suite.set("tests", str(len(suite.findall("testcase"))))


def _mark(case: ET.Element, verdict: Verdict, what: str, text: str) -> None:
    if verdict.accepted:
        return
    tag = {Verdict.FAIL: "failure", Verdict.ERROR: "error"}.get(verdict, "skipped")
    ET.SubElement(case, tag, message=_clean(what)).text = _clean(text)


def _clean(text: str) -> str:
    return _NOT_XML.sub("?", text)
