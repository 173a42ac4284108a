"""The comparison as a suite of its own in the run's `junit.xml`, for CI that reads nothing else."""

from pathlib import Path
from xml.etree import ElementTree

from bench.baseline.verdict import Comparison
from bench.verdict import Verdict

SUITE = "baseline"


def add_to_junit(path: Path, found: Comparison) -> None:
    """Add it, or replace the one of an earlier comparison; a file that is missing or damaged is begun anew."""
    try:
        root = ElementTree.parse(path).getroot()
    except (OSError, ElementTree.ParseError):
        root = ElementTree.Element("testsuites")
    for old in root.findall(f"testsuite[@name='{SUITE}']"):
        root.remove(old)
    suite = ElementTree.SubElement(root, "testsuite", name=SUITE)
    _case(suite, "verdict", found.verdict, found.reason)
    for finding in found.findings:
        if finding.verdict is not None:
            _case(suite, finding.name, finding.verdict, finding.why)
    for name, tag in (("failures", "failure"), ("errors", "error"), ("skipped", "skipped")):
        suite.set(name, str(len(suite.findall(f"testcase/{tag}"))))
    suite.set("tests", str(len(suite.findall("testcase"))))
    part = path.with_name(path.name + ".part")
    ElementTree.ElementTree(root).write(part, encoding="utf-8", xml_declaration=True)
    part.replace(path)


def _case(suite: ElementTree.Element, name: str, verdict: Verdict, text: str) -> None:
    case = ElementTree.SubElement(suite, "testcase", classname="saranga.baseline", name=name)
    if not verdict.accepted:
        tag = {Verdict.FAIL: "failure", Verdict.ERROR: "error"}.get(verdict, "skipped")
        said = "".join(c if c >= " " else "?" for c in f"{verdict.value}: {text}")
        ElementTree.SubElement(case, tag, message=said)
