"""The page of a search for the hardest course: one HTML file that works offline."""

from pathlib import Path
from typing import Any

from bench.campaign_figures import flight_map, two_rates_figure
from bench.drawing import OUTCOME_WORDS
from bench.page import write_page_file

PAGE_FILE = "report.html"
MOST_MAPS = 24
WORDS = {"PASS": "a harder course was found", "INCONCLUSIVE": "not shown to be harder",
         "ERROR": "the bench itself failed"}


def write_hardest_page(folder: Path, summary: dict[str, Any]) -> Path:
    """Write `report.html` from the summary and the flights kept in the folder.

    Raises:
        BenchError: the page cannot be written.
    """
    found = summary["found"]
    over = [] if found is None else [t for t in summary["flights"]
                                     if t["course"] == found["course"]["key"] and t["files"].get("trial")]
    return write_page_file(
        folder / PAGE_FILE, "hardest_page.html.j2", {}, summary=summary, found=found, words=WORDS[summary["verdict"]],
        rates="" if found is None else two_rates_figure([("this course", found["fresh"]),
                                                         ("the family", found["family"])]),
        maps=[(t, flight_map(folder, t)) for t in over[:MOST_MAPS]], more=max(len(over) - MOST_MAPS, 0),
        ranked=_ranked(summary), outcome_words=OUTCOME_WORDS, name=folder.resolve().name)


def _ranked(summary: dict[str, Any]) -> list[tuple[str, float, int, int]]:
    """Course, badness when it was halved, flights and successes of the search."""
    rows = []
    for key, bad in (summary["found"] or {"drawn": []})["drawn"]:
        flown = [t for t in summary["flights"] if t["course"] == key and not t["stage"].startswith("fresh")]
        rows.append((key, bad, len(flown), sum(t["success"] for t in flown)))
    return rows
