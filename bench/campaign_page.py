"""The page of a campaign: one HTML file that works offline, from `summary.json` and the files of the trials."""

from collections import Counter
from pathlib import Path
from typing import Any

from bench.campaign_figures import against_traversability, flight_map, rates_figure
from bench.campaign_table import fault_cells, origin_text, rate_text, screening_cells, speed_text
from bench.drawing import OUTCOME_WORDS, Flight, outcome_colour
from bench.flight_svg import echo_strip, top_view
from bench.page import write_page_file
from bench.verdict import Verdict
from saranga.errors import BenchError, UsageError
from sitl.trial_types import FlightLog, TrialResult

PAGE_FILE = "report.html"
MOST_FAILURES = 16
"""Drawn in the gallery, at about 0.2 MB each; of every row and label one first."""
MOST_MAPS = 24
"""A row."""
WORDS = {"PASS": "every row holds", "MARGINAL": "holds, close to a limit", "FAIL": "a row does not hold",
         "INCONCLUSIVE": "not enough trials to tell", "ERROR": "the bench itself failed"}


def write_campaign_page(folder: Path) -> Path:
    """Write `report.html`; what is missing in the folder is shown as missing.

    Raises:
        UsageError: the folder has no readable summary of a campaign. BenchError: the page cannot be written.
    """
    summary = read_summary(folder)
    failed = [t for t in summary["outcomes"] if not Verdict(t["verdict"]).accepted]
    drawn = _telling(failed)
    rows = []
    for row in summary["rows"]:
        trials = [t for t in summary["outcomes"] if t["row"] == row["name"]]
        rows.append({**row, "maps": [(t, flight_map(folder, t)) for t in trials[:MOST_MAPS]],
                     "more": max(len(trials) - MOST_MAPS, 0), "paper_text": rate_text(row["paper"]),
                     "strict_text": rate_text({**row["strict"], "trials": row["trials"]}),
                     "lenient_text": rate_text({**row["lenient"], "trials": row["trials"]})})
    return write_page_file(
        folder / PAGE_FILE, "campaign_page.html.j2", {}, summary=summary, words=WORDS[summary["verdict"]], rows=rows,
        rates=rates_figure(summary["rows"]), traversability=against_traversability(summary["rows"]),
        faults=[fault_cells(row) for row in summary["rows"] if row["acceptable"]],
        held_to_paper=any(row["paper"] for row in summary["rows"]),
        screening=screening_cells(summary["screening"]), speed=speed_text(summary["metrics"]),
        origin=origin_text(summary),
        labels=Counter(t["label"] for t in failed if t.get("label")).most_common(),
        failures=[{**t, **_pictures(folder, t)} for t in drawn], failed=len(failed),
        outcome_words=OUTCOME_WORDS, outcome_colour=outcome_colour, name=folder.resolve().name)


def read_summary(folder: Path) -> dict[str, Any]:
    """`summary.json` of a campaign.

    Raises:
        UsageError: it is missing, damaged, or not of a campaign.
    """
    import json

    path = folder / "summary.json"
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise UsageError(f"{path}: cannot be read ({error}): `saranga-bench report {folder}` makes it anew") from error
    if not isinstance(summary, dict) or not {"rows", "outcomes", "suite"} <= summary.keys():
        raise UsageError(f"{path}: is not the summary of a campaign")
    return summary


def _telling(failed: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Failures to draw: the first of every row and label, then others, in order."""
    seen: set[tuple[str, str]] = set()
    first: list[dict[str, Any]] = []
    rest: list[dict[str, Any]] = []
    for trial in failed:
        key = (trial["row"], str(trial.get("label")))
        (rest if key in seen else first).append(trial)
        seen.add(key)
    return (first + rest)[:MOST_FAILURES]


def _pictures(folder: Path, trial: dict[str, Any]) -> dict[str, str]:
    name = trial.get("files", {}).get("log")
    if not name:
        return {"top": "", "echoes": "", "missing": "no flight log was kept"}
    nan = float("nan")
    result = TrialResult(
        scene=str(trial["scene"]), seed=int(trial["seed"]), outcome=str(trial["outcome"]), cause=str(trial["cause"]),
        part=None, success_strict=False, success_lenient=trial.get("success_lenient") is True, min_clearance_m=nan,
        duration_s=nan, sim_s=nan, wall_s=nan, realtime_factor=nan, determinism_hash="", landed=False, autopilot={},
        denoiser="", stack="", shield="")
    try:
        flight = Flight(FlightLog.load(folder / name), result)
        return {"top": top_view(flight), "echoes": echo_strip(flight), "missing": ""}
    except (BenchError, OSError, ValueError, KeyError) as error:
        return {"top": "", "echoes": "", "missing": str(error)}
