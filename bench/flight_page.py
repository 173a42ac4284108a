"""The page of a run: one HTML file that needs nothing else, made from the journal and the flight logs beside it.

Verdict and cause first, then figures with their origin, limits, every flight with the line that flies it again,
drawings of the flights, and where everything came from.
"""

from collections import Counter
from pathlib import Path
from typing import Any

from bench.drawing import OUTCOME_WORDS, Flight, outcome_colour
from bench.flight_summary import summarise
from bench.flight_svg import echo_strip, legend, side_view, top_view
from bench.journal import FILE_NAME, read_journal
from bench.page import write_page_file
from bench.verdict_text import metres, seconds
from saranga.errors import BenchError, UsageError
from sitl.trial_types import FlightLog, TrialResult

PAGE_FILE = "report.html"
MAX_DRAWN = 24
"""Flights drawn on one page, failed ones first; a drawing is about 150 kB."""
OPEN_DRAWINGS = 3
_FIGURES = (
    ("success_rate_strict", "clean flights"),
    ("success_rate", "success, net touches allowed"),
    ("min_clearance_m", "smallest clearance"),
    ("duration_s", "course time, median"),
    ("realtime_factor", "simulated over real time, median"),
)
_PASS_WORDS = {"PASS": "passed", "MARGINAL": "passed, close to a limit", "FAIL": "failed",
               "INCONCLUSIVE": "not enough to tell", "ERROR": "the bench itself failed"}


def write_page(run_dir: Path) -> Path:
    """Write `report.html` of a run from its journal; a flight whose log is missing or damaged says so.

    Raises:
        UsageError: no readable journal of flights in `run_dir`.
        BenchError: the page cannot be written.
    """
    journal = read_journal(run_dir / FILE_NAME)
    if journal.header.get("run_kind") not in ("fly", "test"):
        raise UsageError(f"{run_dir}: its journal is not one of flights; `saranga-bench runs` lists the runs")
    summary = summarise(journal)
    for number, outcome in enumerate(summary["outcomes"]):
        outcome["anchor"] = f"flight-{number + 1}"
    flights = [_flight(run_dir, outcome) for outcome in _drawn(summary["outcomes"])]
    for number, flight in enumerate(flights):
        flight["open"] = number < OPEN_DRAWINGS
    return write_page_file(
        run_dir / PAGE_FILE, "flight_page.html.j2", {"metres": metres, "seconds": seconds},
        summary=summary, title=_title(summary), tests=journal.of("test"),
        lead=_lead(summary, journal.of("test")), verdict_words=_PASS_WORDS[summary["verdict"]],
        figures=_figures(summary), words=OUTCOME_WORDS, outcome_colour=outcome_colour, flights=flights,
        setpoints=_setpoints(run_dir, summary), left_out=len(summary["outcomes"]) - len(flights),
        provenance=_provenance(summary), started=journal.header.get("utc", ""),
        name=run_dir.resolve().name)


def _setpoints(run_dir: Path, summary: dict[str, Any]) -> list[dict[str, str]]:
    """Strips of the setpoints of flights with a companion in the loop."""
    if "companion" not in summary:
        return []
    from bench.hil.figure import setpoint_figures

    return setpoint_figures(run_dir, summary["outcomes"])


def _drawn(outcomes: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The flights to draw: what failed first, then by order flown."""
    return sorted(outcomes, key=lambda outcome: outcome["outcome"] == "clean")[:MAX_DRAWN]


def _title(summary: dict[str, Any]) -> str:
    count = len(summary["outcomes"])
    scenes = ", ".join(dict.fromkeys(str(outcome["scene"]) for outcome in summary["outcomes"]))
    flights = "1 flight" if count == 1 else f"{count} flights"
    return " · ".join(part for part in (scenes, str(summary["provenance"]["autopilot"]["kind"]), flights) if part)


def _lead(summary: dict[str, Any], tests: list[dict[str, Any]]) -> str:
    """Why the verdict is what it is, in a sentence or two."""
    if summary["errors"]:
        return "; ".join(summary["errors"])
    outcomes = summary["outcomes"]
    planned = f" of {summary['trials_planned']}" if summary["trials_planned"] else ""
    cut = f" Cut short after {len(outcomes)}{planned}." if summary["interrupted"] else ""
    if tests:
        return _tests_lead(tests) + cut
    if not outcomes:
        return "no flight was finished"
    if len(outcomes) == 1:
        held = next((c for c in summary["checks"] if c["verdict"] == summary["verdict"]), None)
        clean = outcomes[0]["verdict"] in ("PASS", "MARGINAL") and summary["verdict"] not in ("PASS", "MARGINAL")
        but = f". Yet {held['name']}: {held['why']}." if held is not None and clean else ""
        return str(outcomes[0]["cause"]) + but + cut
    counts = Counter(outcome["outcome"] for outcome in outcomes)
    tally = ", ".join(f"{count} × {OUTCOME_WORDS.get(name, name)}" for name, count in counts.most_common())
    bad = next((o for o in outcomes if o["verdict"] not in ("PASS", "MARGINAL")), None)
    first = f" First failure, seed {bad['seed']}: {bad['cause']}." if bad else ""
    return f"{tally}.{first}{cut}"


def _tests_lead(tests: list[dict[str, Any]]) -> str:
    counts = Counter(str(test["outcome"]) for test in tests)
    tally = ", ".join(f"{count} {'test' if count == 1 else 'tests'} {name}" for name, count in counts.most_common())
    bad = next((test for test in tests if test["outcome"] == "failed"), None)
    return f"{tally}." + (f" First failure, {bad['test']}: {bad.get('text', '')}." if bad else "")


def _figures(summary: dict[str, Any]) -> list[dict[str, str]]:
    metrics, detail, out = summary["metrics"], summary["metrics_detail"], []
    single = metrics["trials"] == 1
    for key, words in _FIGURES:
        value = metrics.get(key)
        if single:
            if key.startswith("success"):  # the rate of one flight says less than its outcome
                continue
            words = words.removesuffix(", median")
        if value is None:
            text = "–"
        elif key.startswith("success"):
            low, high = metrics["success_interval" + ("_strict" if key.endswith("strict") else "")]
            text, words = f"{value:.0%}", f"{words} ({low:.0%} to {high:.0%} at 95 %)"
        else:
            text = {"m": metres, "s": seconds}.get(detail[key]["unit"], lambda v: f"{v:.1f}×")(value)
        out.append({"value": text, "words": words, "origin": detail[key]["origin"]})
    return out


def _provenance(summary: dict[str, Any]) -> list[tuple[str, str]]:
    found = summary["provenance"]
    autopilot, git = found["autopilot"], found.get("git") or {}
    commit = f"{git.get('commit') or 'unknown'}" + (" with local changes" if git.get("dirty") else "")
    rows = [
        ("origin", found["origin"]),
        ("autopilot", f"{autopilot['kind']} {autopilot.get('version') or ''}".strip()),
        ("stack", found["stack"]), ("denoiser", found["denoiser"]),
        ("weights", " · ".join(filter(None, (found["weights_sha256"], found.get("runtime")))) or "none"),
        ("shield", found["shield"]), ("noise behind it", _noise(found.get("shield_noise"))), ("sonar", found["sonar"]),
        ("faults", ", ".join(f"{k}={v}" for k, v in (found["faults"] or {}).items()) or "none"),
        ("determinism hash", summary["metrics"]["determinism_hash"] or "none"),
        ("git", commit),
    ]
    rows += [(f"sha256 of {name}", value) for name, value in (found.get("sha256") or {}).items()]
    rows += [(name, value) for name, value in (found.get("versions") or {}).items()]
    return [(name, str(value)) for name, value in rows]


def _noise(said: dict[str, Any] | None) -> str:
    """Origin of the noise behind the shield, and how far the flight went beyond what was measured."""
    if not said:
        return "unknown"
    words = f"{said['origin']}: {said['source']} ({said['applied']})"
    if said.get("cycles"):
        low, high = said["swept_n"]
        words += (f"; above the swept {low:.3g} to {high:.3g} N in {said['above_sweep_share']:.0%} and below in "
                  f"{said['below_sweep_share']:.0%} of the cycles in flight")
    return words


def _flight(run_dir: Path, outcome: dict[str, Any]) -> dict[str, Any]:
    """Drawings of one flight, or the reason why there are none."""
    shown: dict[str, Any] = {"outcome": outcome, "missing": "", "top": "", "side": "", "echoes": "", "legend": [],
                             "events": []}
    name = (outcome.get("files") or {}).get("log")
    if not name:
        shown["missing"] = "no flight log was kept"
        return shown
    path = Path(name)
    try:
        log = FlightLog.load(path if path.is_absolute() else run_dir / path)
        flight = Flight(log, _result(outcome))
        shown.update(top=top_view(flight), side=side_view(flight), echoes=echo_strip(flight),
                     legend=legend(o.kind for o in flight.scene.obstacles),
                     events=[(t_us * 1e-6, text) for t_us, text in log.events])
    except BenchError as error:
        shown["missing"] = str(error)
    return shown


def _result(outcome: dict[str, Any]) -> TrialResult:
    """A result with what the drawings show of it, from the summary."""
    nan = float("nan")

    def number(key: str) -> float:
        value = outcome.get(key)
        return nan if value is None else float(value)

    return TrialResult(
        scene=str(outcome["scene"]), seed=int(outcome["seed"]), outcome=str(outcome["outcome"]),
        cause=str(outcome["cause"]), part=outcome.get("part"), success_strict=outcome.get("success_strict") is True,
        success_lenient=outcome.get("success_lenient") is True, min_clearance_m=number("min_clearance_m"),
        duration_s=number("duration_s"), sim_s=number("sim_s"), wall_s=number("wall_s"),
        realtime_factor=number("realtime_factor"), determinism_hash=str(outcome.get("determinism_hash") or ""),
        landed=outcome.get("landed") is True, autopilot={}, denoiser="", stack="", shield="")
