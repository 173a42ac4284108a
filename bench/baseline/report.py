"""A comparison in words: for the terminal, and in Markdown for a CI step."""

import math

from bench.baseline.measures import TESTS
from bench.baseline.verdict import Comparison, Finding
from bench.campaign_table import aligned
from bench.step_summary import cell

HEAD = ["measure", "before", "now", "worse by", "p", "would have shown", "verdict"]


def finding_cells(f: Finding) -> list[str]:
    """One line of the table; a dash where there is no value."""
    scale, unit = (100.0, "points") if f.name == "success" else (1.0, "" if f.unit == "1" else f.unit)

    def number(value: float, sign: bool = False) -> str:
        return f"{value * scale:{'+' if sign else ''}.3g}" if math.isfinite(value) else "-"

    if f.verdict is None or not math.isfinite(f.p):
        return [f.name, "-", "-", "-", "-", "-", f"{f.verdict.value if f.verdict else 'not compared'}: {f.why}"]
    worse = f"{number(f.worse_by, True)} ({number(f.low, True)} to {number(f.high, True)}) {unit}"
    return [f.name, number(f.baseline), number(f.run), worse.strip(), f"{f.p:.2g}",
            f"{number(f.would_see)} {unit}".strip(), f.verdict.value]


def comparison_text(c: Comparison) -> str:
    """Table, notes and verdict."""
    lines = aligned([HEAD, *(finding_cells(f) for f in c.findings)]) if c.findings else []
    told = [*(f"note: {note}" for note in c.notes), *(f"broken: {text}" for text in c.broken[:5])]
    return "\n".join([*lines, _method(c), *told,
                      f"{c.verdict.value}   against {c.baseline}: {c.reason}"])


def comparison_markdown(c: Comparison) -> str:
    """The same for a CI step."""
    lines = [f"## Against the baseline: {c.verdict.value}", "", f"{cell(c.reason)}.", ""]
    if c.findings:
        lines += ["| " + " | ".join(HEAD) + " |", "|" + " --- |" * len(HEAD)]
        lines += ["| " + " | ".join(cell(text) for text in finding_cells(f)) + " |" for f in c.findings]
    lines += ["", cell(_method(c)), *(f"- {cell(note)}" for note in (*c.notes, *c.broken[:5]))]
    return "\n".join([*lines, "", ""])


def _method(c: Comparison) -> str:
    how = "McNemar, signed ranks" if c.paired else "Fisher, Mann-Whitney"
    pairs = f"{c.pairs} flights a side"
    if c.paired:
        pairs = f"{c.pairs} pairs of flights, {c.identical} bit for bit the same"
    return (f"{pairs}; one-sided ({how}) at {c.confidence:g} confidence for all {TESTS} tests together (Bonferroni); "
            "simulated")
