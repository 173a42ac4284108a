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


SCREENING_HEAD = ["scene", "pairs", "embedded", "real", "difference", "same success", "same outcome", "kappa",
                  "McNemar p", "paths apart, RMS", "at most"]


def screening_cells(screening: dict[str, Any] | None) -> list[list[str]]:
    """Head and a line a row and one for all of them; empty where nothing was screened."""
    if screening is None:
        return []
    lines = [SCREENING_HEAD]
    for name, found in [*((row["name"], row) for row in screening["rows"]), ("all", screening["all"])]:
        if not found["pairs"]:
            lines.append([name, "0", *["-"] * (len(SCREENING_HEAD) - 2)])
            continue
        kappa, paths = found["kappa"], found["paths"]
        low, high = found["difference"]["interval"]
        same_low, same_high = found["agreement"]["interval"]
        lines.append([
            name, str(found["pairs"]), f"{100 * found['fast_rate']:.0f} %", f"{100 * found['slow_rate']:.0f} %",
            f"{100 * found['difference']['value']:+.0f} ({100 * low:+.0f} to {100 * high:+.0f})",
            f"{100 * found['agreement']['rate']:.0f} % ({100 * same_low:.0f} to {100 * same_high:.0f})",
            f"{100 * found['same_outcome'] / found['pairs']:.0f} %",
            "-" if kappa is None else "{:.2f} ({:.2f} to {:.2f})".format(kappa["value"], *kappa["interval"]),
            f"{found['mcnemar_p']:.2g}",
            "-" if paths is None else f"{paths['rms_m']:.2f}, {paths['rms_p90_m']:.2f} m",
            "-" if paths is None else f"{paths['max_m']:.2f} m"])
    return lines


def aligned(table: list[list[str]]) -> list[str]:
    """Lines of a table in columns."""
    widths = [max((len(line[k]) for line in table), default=0) for k in range(len(table[0]) if table else 0)]
    return ["  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip() for line in table]


def fault_cells(row: dict[str, Any]) -> list[str]:
    """Name and faults, verdict, what the flights did, what is acceptable and why."""
    planted = ", ".join(f"{name}={value:g}" if isinstance(value, float | int) else f"{name}={value}"
                        for name, value in row["faults"].items())
    asked = row["acceptable"]
    limit = asked.get("touched_at_most")
    may = " or ".join(word.replace("_", " ") for word in asked["may"])
    may += f", touched in {100 * limit:.0f} % at most" if limit is not None else ""
    may += f', saying "{asked["says"]}"' if asked.get("says") else ""
    return [f"{row['name']} ({planted})" if planted else row["name"], row["verdict"], row["reason"],
            f"{may}: {asked['reason']}"]


def table_text(summary: Summary) -> str:
    """The table, comparisons, the campaign's speed and its verdict; `*` marks the rule that decides a row."""
    plain = [row for row in summary["rows"] if not row["acceptable"]]
    lines = aligned([HEAD, *(row_cells(row) for row in plain)]) if plain else []
    for row in summary["rows"]:
        if row["acceptable"]:
            name, verdict, did, asked = fault_cells(row)
            lines += [f"{verdict:<12} {name}", f"             did: {did}", f"             acceptable: {asked}"]
    lines += [f"{c['name']}: {c['verdict']}, {c['reason']}" for c in summary["comparisons"]]
    if summary["screening"] is not None:
        lines += ["", *aligned(screening_cells(summary["screening"])),
                  f"screening: {summary['screening']['verdict']}, {summary['screening']['reason']}"]
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
