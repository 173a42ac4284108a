"""A campaign in Markdown, for the summary of a CI step."""

from typing import Any

from bench.campaign_table import HEAD, fault_cells, origin_text, row_cells, screening_cells, speed_text
from bench.step_summary import cell as _cell
from bench.verdict import Verdict

MOST_FAILURES = 10


def markdown_summary(summary: dict[str, Any]) -> str:
    """Verdict, table, comparisons, and the first failures with the line that flies each again."""
    lines = [f"## Campaign {_cell(summary['suite']['name'])}: {summary['verdict']}", "",
             f"{_cell(summary['suite']['description'])}. {speed_text(summary['metrics'])}.", ""]
    rated = [row for row in summary["rows"] if not row["acceptable"]]
    if rated:
        lines += ["| " + " | ".join(HEAD) + " |", "|" + " --- |" * len(HEAD)]
        lines += ["| " + " | ".join(_cell(cell) for cell in row_cells(row)) + " |" for row in rated]
        lines += ["", "`*`: the rule that decides. Intervals: Wilson, 95 %.", ""]
    if any(row["acceptable"] for row in summary["rows"]):
        lines += ["| fault | verdict | what the flights did | acceptable, and why |", "| --- | --- | --- | --- |"]
        lines += ["| " + " | ".join(_cell(cell) for cell in fault_cells(row)) + " |" for row in summary["rows"]
                  if row["acceptable"]]
        lines.append("")
    lines += [f"- **{_cell(c['name'])}**: {c['verdict']}, {_cell(c['reason'])}" for c in summary["comparisons"]]
    if summary["screening"] is not None:
        head, *rows = screening_cells(summary["screening"])
        lines += [f"- **screening**: {summary['screening']['verdict']}, {_cell(summary['screening']['reason'])}", "",
                  "| " + " | ".join(head) + " |", "|" + " --- |" * len(head),
                  *("| " + " | ".join(_cell(cell) for cell in row) + " |" for row in rows), ""]
    lines += [f"- error: {_cell(text)}" for text in summary["errors"][:MOST_FAILURES]]
    failed = [t for t in summary["outcomes"] if not Verdict(t["verdict"]).accepted]
    if failed:
        lines += ["", f"### {len(failed)} trials that did not pass"]
        lines += [f"- {_cell(t['row'])} seed {t['seed']}: {t['outcome']}, {_cell(t.get('label') or 'no label')}. "
                  f"{_cell(t.get('label_reason') or t.get('cause') or '')}\n  `{t['replay']}`"
                  for t in failed[:MOST_FAILURES]]
        if len(failed) > MOST_FAILURES:
            lines.append(f"- and {len(failed) - MOST_FAILURES} more: see the page")
    return "\n".join([*lines, "", _cell(origin_text(summary)), ""])
