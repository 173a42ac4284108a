"""What docs/ci.md and docs/faults.md list is what there is."""

import dataclasses
import re
from pathlib import Path

from bench import plugin
from bench.baseline.measures import MEASURES, TESTS
from bench.baseline.rank_tests import least_pairs
from bench.baseline.verdict import CONFIDENCE
from bench.campaign.suite import load_suite
from sitl.faults import fault_modules
from sitl.trial_types import Faults

DOCS = Path(__file__).resolve().parent.parent.parent / "docs"


def test_every_fault_is_in_the_table() -> None:
    text = (DOCS / "faults.md").read_text()
    names = {f.name for f in dataclasses.fields(Faults)} - {"planted"} | set(fault_modules())
    assert [name for name in sorted(names) if f"`{name}`" not in text] == []


def test_the_row_in_the_document_is_one_of_the_suite() -> None:
    text = (DOCS / "faults.md").read_text()
    row = next(r for r in load_suite("faults").rows if r.name == "dead-right")
    assert row.acceptable is not None and f'says = "{row.acceptable.says}"' in text


def test_every_option_of_the_plugin_is_listed() -> None:
    source = Path(plugin.__file__).read_text()
    text = (DOCS / "ci.md").read_text()
    options = set(re.findall(r'"(--bench-[a-z-]+)"', source))
    assert len(options) >= 5 and [name for name in sorted(options) if f"`{name}" not in text] == []


def test_the_figures_of_the_comparison_are_the_codes() -> None:
    text = (DOCS / "ci.md").read_text()
    for measure in MEASURES:
        row = next(line for line in text.splitlines() if line.startswith(f"| `{measure.name}`"))
        assert f"| {'more' if measure.sign > 0 else 'less'} |" in row
        assert row.endswith(f"| {measure.margin:g}{'' if measure.unit == '1' else ' ' + measure.unit} |"), row
    assert f"confidence, {CONFIDENCE:g} unless" in text and TESTS == 7 and "seven tests" in text
    assert f"fewer than {least_pairs((1 - CONFIDENCE) / TESTS)} pairs ({least_pairs(0.05 / TESTS)} at 0.95)" in text
