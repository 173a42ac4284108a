"""What a person sees while trials fly, on stderr; and the summary of a run as text."""

import sys
from pathlib import Path
from typing import Any, Protocol, TextIO

from bench.verdict import Verdict
from sitl.trial_types import TrialProgress, TrialResult

COLOURS = {"PASS": "green", "MARGINAL": "yellow", "FAIL": "red", "INCONCLUSIVE": "yellow", "ERROR": "red"}
ANSI = {"green": "\x1b[1;32m", "yellow": "\x1b[1;33m", "red": "\x1b[1;31m"}


class Reporter(Protocol):
    """Told what happens, trial by trial."""

    def begin(self, seed: int) -> None:
        """A trial starts."""

    def progress(self, progress: TrialProgress) -> None:
        """It goes on."""

    def finish(self, result: TrialResult, verdict: Verdict) -> None:
        """It is over."""

    def note(self, text: str) -> None:
        """Something worth a line."""

    def close(self) -> None:
        """No more is to come."""


def make_reporter(trials: int, quiet: bool, stream: TextIO | None = None) -> Reporter:
    """Bars on a terminal, lines elsewhere, nothing but notes when quiet."""
    stream = stream or sys.stderr
    if not quiet and stream.isatty():
        return BarReporter(trials)
    return LineReporter(stream, quiet)


def result_line(result: TrialResult) -> str:
    """Outcome, clearance and speed of one flight in one line."""
    clearance = f"nearest {result.min_clearance_m:.2f} m, " if result.min_clearance_m < 1e3 else ""
    cause = f" ({result.cause})" if result.cause and result.outcome != "clean" else ""
    return f"{result.outcome}{cause}, {clearance}{result.sim_s:.1f} s simulated at {result.realtime_factor:.1f}x"


class LineReporter:
    """One line a phase, for logs and pipes."""

    def __init__(self, stream: TextIO, quiet: bool = False) -> None:
        self._stream = stream
        self._quiet = quiet
        self._seed = 0
        self._phase = ""

    def begin(self, seed: int) -> None:
        self._seed, self._phase = seed, ""

    def progress(self, progress: TrialProgress) -> None:
        if progress.phase != self._phase and not self._quiet:
            self._phase = progress.phase
            self.note(
                f"seed {self._seed}: {progress.phase}, t {progress.t_s:.1f} s, x {progress.x_m:.1f} of "
                f"{progress.goal_x_m:.1f} m, {progress.realtime_factor:.1f}x"
            )

    def finish(self, result: TrialResult, verdict: Verdict) -> None:
        if not self._quiet:
            self.note(f"seed {result.seed}: {verdict.value} {result_line(result)}")

    def note(self, text: str) -> None:
        print(text, file=self._stream, flush=True)

    def close(self) -> None:
        pass


class BarReporter:
    """One bar a trial: seed, phase, how far along the course, speed."""

    def __init__(self, trials: int) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn

        self._trials = trials
        self._flown = 0
        self._console = Console(stderr=True, highlight=False)
        self._bars = Progress(
            TextColumn("{task.description}"),
            TextColumn("{task.fields[phase]:<8}"),
            BarColumn(30),
            TextColumn("{task.fields[where]}"),
            console=self._console,
            transient=True,
        )
        self._task: Any = None
        self._bars.start()

    def begin(self, seed: int) -> None:
        self._flown += 1
        name = f"flight {self._flown} of {self._trials}, seed {seed}"
        self._task = self._bars.add_task(name, total=1.0, phase="loading", where="")

    def progress(self, progress: TrialProgress) -> None:
        goal_m = max(progress.goal_x_m, 1e-9)
        self._bars.update(
            self._task,
            completed=min(max(progress.x_m / goal_m, 0.0), 1.0),
            phase=progress.phase,
            where=f"{progress.x_m:5.1f} of {progress.goal_x_m:.1f} m  {progress.realtime_factor:.1f}x",
        )

    def finish(self, result: TrialResult, verdict: Verdict) -> None:
        self._bars.remove_task(self._task)
        self._console.print(f"seed {result.seed}: [bold {COLOURS[verdict.value]}]{verdict.value}[/] ", end="")
        self._console.print(result_line(result), markup=False)

    def note(self, text: str) -> None:
        self._console.print(text, markup=False)

    def close(self) -> None:
        self._bars.stop()


def _noise_origin(provenance: dict[str, Any]) -> str:
    """" (noise measured: run and propeller)" where the noise behind the shield is not computed from its geometry."""
    said = provenance.get("shield_noise") or {}
    if said.get("origin", "simulated") == "simulated":
        return ""
    return f" (noise {said['origin']}: {said['source']})"


def summary_text(summary: dict[str, Any], colour: bool) -> str:
    """The run for a person: verdict first, then why, then where to look."""
    provenance, metrics = summary["provenance"], summary["metrics"]
    verdict = summary["verdict"]
    head = f"{ANSI[COLOURS[verdict]]}{verdict}\x1b[0m" if colour else verdict
    autopilot = provenance["autopilot"]
    kind = autopilot["kind"] + (f" {autopilot['version']}" if autopilot["version"] else "")
    scenes = ", ".join(dict.fromkeys(o["scene"] for o in summary["outcomes"])) or "nothing flown"
    lines = [
        f"{head}  {scenes}: {len(summary['outcomes'])} of {summary['trials_planned']} flights, simulated, "
        f"autopilot {kind}, stack {provenance['stack']}, denoiser {provenance['denoiser']}, "
        f"shield {provenance['shield']}{_noise_origin(provenance)}"
    ]
    if len(summary["outcomes"]) == 1 and verdict == Verdict.PASS:
        lines.append(f"  clean: {summary['outcomes'][0]['cause']}")
    for outcome in summary["outcomes"]:
        if not Verdict(outcome["verdict"]).accepted:
            lines += [
                f"  seed {outcome['seed']}: {outcome['outcome']}: {outcome['cause']}",
                f"    again: {outcome['replay']}",
            ]
    if metrics["trials"] > 1:
        low, high = metrics["success_interval_strict"]
        lines.append(
            f"  clean {metrics['success_rate_strict']:.1%} (95 % interval {low:.1%} to {high:.1%}), "
            f"with net touches {metrics['success_rate']:.1%}"
        )
    if metrics["realtime_factor"] is not None:
        nearest = "" if metrics["min_clearance_m"] is None else f"nearest {metrics['min_clearance_m']:.2f} m, "
        lines.append(
            f"  {nearest}{metrics['realtime_factor']:.1f}x real time, "
            f"hash {(metrics['determinism_hash'] or 'none')[:16]}"
        )
    if summary["trials_planned"] > 1:
        lines += [f"  limit {c['name']} {c['limit']}: {c['verdict']}: {c['why']}" for c in summary["checks"]]
    lines += [f"  warning: {text}" for text in summary["warnings"]]
    if summary["interrupted"]:
        lines.append(f"  cut short: {len(summary['outcomes'])} of {summary['trials_planned']} flights are in it")
    lines.append(f"  run    {summary['run']}")
    if summary["outcomes"]:
        lines.append(f"  look   saranga-bench view {_short(summary['run'])}")
    return "\n".join(lines)


def _short(run: str) -> str:
    """The run's id where the default root finds it, else its path."""
    from bench.store import runs_root

    path = Path(run)
    return path.name.rsplit("-", 1)[-1] if path.parent == runs_root() else run
