"""A campaign's table as text, for the terminal and for a CI step."""

from typing import Any

Summary = dict[str, Any]


def rate_text(rate: dict[str, Any] | None) -> str:
    """Such as "15 of 20, 75 % (53 to 89)"; a dash where nothing was flown."""
    if not rate or rate.get("rate") is None:
        return "-"
    low, high = rate["interval"]
    count = rate.get("trials")
    seen = f"{rate['successes']} of {count}, " if count is not None else ""
    return f"{seen}{100 * rate['rate']:.0f} % ({100 * low:.0f} to {100 * high:.0f})"


def row_cells(row: dict[str, Any]) -> list[str]:
    """Name, paper, ours strict and lenient, traversability, verdict."""
    def ours(rule: str) -> str:
        mark = " *" if row["rule"] == rule else ""
        return rate_text({**row[rule], "trials": row["trials"]}) + mark

    course = row.get("traversability")
    crowded = "-" if not course else f"{course['mean']:.1f}" + (f" / {course['paper']:g}" if course["paper"] else "")
    more = f", {row['trials_needed']} more" if row.get("trials_needed") else ""
    return [row["name"], rate_text(row["paper"]), ours("strict"), ours("lenient"), crowded, row["verdict"] + more]


HEAD = ["row", "paper", "ours, strict", "ours, lenient", "traversability, ours / paper", "verdict"]


def table_text(summary: Summary) -> str:
    """The table, comparisons, the campaign's speed and its verdict; `*` marks the rule that decides a row."""
    table = [HEAD, *(row_cells(row) for row in summary["rows"])]
    widths = [max(len(line[k]) for line in table) for k in range(len(HEAD))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip() for line in table]
    lines += [f"{c['name']}: {c['verdict']}, {c['reason']}" for c in summary["comparisons"]]
    lines += ["", speed_text(summary["metrics"]), origin_text(summary), f"{summary['verdict']}   {summary['run']}"]
    return "\n".join(lines)


def speed_text(metrics: dict[str, Any]) -> str:
    """Trials an hour, real-time factor, workers, memory: measured."""
    if not metrics["trials_per_hour"]:
        return f"{metrics['trials']} of {metrics['planned']} trials"
    return (f"{metrics['trials']} of {metrics['planned']} trials in {metrics['wall_s'] / 60:.1f} min: "
            f"{metrics['trials_per_hour']:.0f} an hour, {metrics['aggregate_realtime_factor']:.1f}x real time, "
            f"{metrics['workers']} workers of {metrics['memory_mb_per_worker'] or float('nan'):.0f} MB")


def origin_text(summary: Summary) -> str:
    """Where the numbers come from."""
    p = summary["provenance"]
    weights = f" {p['weights_sha256'][:12]}" if p.get("weights_sha256") else ""
    commit = ((p.get("git") or {}).get("commit") or "unknown")[:10]
    return (f"{p['origin']}; {p['autopilot']['kind']} {p['autopilot'].get('version') or ''}; denoiser {p['denoiser']}"
            f"{weights}; shield {p['shield']}; sources {commit}")
