"""A run of flights in Markdown, for the summary of a CI step: of `fly` and of a pytest session."""

from typing import Any

from bench.step_summary import cell
from bench.verdict import Verdict

MOST_FLIGHTS = 20


def flight_summary_markdown(summary: dict[str, Any], title: str) -> str:
    """Verdict, rate, limits, and the first flights that did not pass with the line that flies each again."""
    metrics, provenance = summary["metrics"], summary["provenance"]
    outcomes = summary["outcomes"]
    wrong = [o for o in outcomes if not Verdict(o["verdict"]).accepted]
    lines = [f"## {cell(title)}: {summary['verdict']}", ""]
    if metrics["success_interval_strict"]:
        low, high = metrics["success_interval_strict"]
        rate = f"{100 * metrics['success_rate_strict']:.0f} % ({100 * low:.0f} to {100 * high:.0f}, Wilson 95 %)"
        lines.append(f"{len(outcomes) - len(wrong)} of {len(outcomes)} flights clean and landed, rate {rate}.")
    else:
        lines.append(f"{len(outcomes)} flights, none of them judged.")
    autopilot = provenance["autopilot"]
    lines += ["", f"{cell(provenance['origin'])}; autopilot {cell(autopilot['kind'])} "
              f"{cell(autopilot.get('version') or '')}; denoiser {cell(provenance['denoiser'])}; shield "
              f"{cell(provenance['shield'])}."]
    if summary["checks"]:
        lines += ["", "| limit | verdict | why |", "| --- | --- | --- |"]
        lines += [f"| {cell(c['name'])} {cell(c['limit'])} | {c['verdict']} | {cell(c['why'])} |"
                  for c in summary["checks"]]
    lines += [f"- error: {cell(text)}" for text in summary["errors"][:MOST_FLIGHTS]]
    if wrong:
        lines += ["", f"### {len(wrong)} flights that did not pass"]
        lines += [f"- seed {o['seed']}: {cell(o['outcome'])}, {cell(o['cause'] or '')}\n  `{o['replay']}`"
                  for o in wrong[:MOST_FLIGHTS]]
        if len(wrong) > MOST_FLIGHTS:
            lines.append(f"- and {len(wrong) - MOST_FLIGHTS} more")
    return "\n".join([*lines, "", ""])
