"""The kill matrix as a command: which cells, progress, table, verdict."""

import json
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bench.provenance import git_state
from bench.supervisor.causes import CAUSES, PHASES
from bench.supervisor.kill_matrix import DEAD_MAN_MS, LIMIT_MS, QUICK, Cell, run_matrix
from bench.verdict import Verdict, worst
from saranga.errors import UsageError


def chosen_cells(causes: Sequence[str], phases: Sequence[str], quick: bool) -> list[tuple[str, str]]:
    """Which cells to run.

    Raises:
        UsageError: an unknown cause or phase, or none left.
    """
    for name in causes:
        if name not in CAUSES:
            raise UsageError(f"--cause {name!r}: known are {', '.join(CAUSES)}")
    for name in phases:
        if name not in PHASES:
            raise UsageError(f"--phase {name!r}: known are {', '.join(PHASES)}")
    cells = QUICK if quick else [(c, p) for c in CAUSES for p in PHASES]
    found = [(c, p) for c, p in cells if (not causes or c in causes) and (not phases or p in phases)]
    if not found:
        raise UsageError("no cell is left by --cause, --phase and --quick together: nothing would be shown")
    return found


def table(cells: Sequence[Cell]) -> str:
    """Markdown: cause x phase, milliseconds to idle; what is not PASS is named."""
    def entry(cause: str, phase: str) -> str:
        found = [c for c in cells if (c.cause, c.phase) == (cause, phase)]
        if not found:
            return "-"
        cell = found[-1]
        ms = f"{cell.ms_to_idle:.0f}" if cell.ms_to_idle < float("inf") else "never"
        return ms if cell.verdict is Verdict.PASS else f"{ms} {cell.verdict.value}"

    rows = [f"| {' | '.join(['cause', *PHASES])} |", f"|{' --- |' * (len(PHASES) + 1)}"]
    rows += [f"| {' | '.join([c, *(entry(c, p) for p in PHASES)])} |" for c in CAUSES if c in {x.cause for x in cells}]
    return "\n".join(rows)


def summary(cells: Sequence[Cell]) -> dict[str, Any]:
    """The command's JSON object."""
    return {"verdict": worst([c.verdict for c in cells]).value, "origin": "emulated",
            "checks": [c.to_dict() for c in cells], "errors": [f"{c.cause} in {c.phase}: {c.why}" for c in cells
                                                               if c.verdict is not Verdict.PASS],
            "metrics": {"limit_ms": LIMIT_MS, "dead_man_ms": DEAD_MAN_MS, "cells": len(cells),
                        "worst_ms": max((c.ms_to_idle for c in cells if c.ms_to_idle < float("inf")), default=None)},
            "outcomes": [], "provenance": {"git": git_state()}, "run": None}


def run_and_report(causes: Sequence[str], phases: Sequence[str], quick: bool, jobs: int, keep: Path | None,
                   as_json: bool) -> int:
    """Run, print, return the exit code."""
    wanted = chosen_cells(causes, phases, quick)
    began_s = time.monotonic()

    def tell(cell: Cell) -> None:
        print(f"{time.monotonic() - began_s:5.0f} s  {cell.cause} in {cell.phase}: {cell.verdict.value}, {cell.why}",
              file=sys.stderr, flush=True)

    with tempfile.TemporaryDirectory(prefix="kill-matrix-") as temporary:
        cells = run_matrix(wanted, (keep or Path(temporary)) / "cells", jobs=jobs, tell=tell)
    found = summary(cells)
    if as_json:
        print(json.dumps(found))
    else:
        print(f"Milliseconds from the cause to idle, by the emulated device's own log; limit {LIMIT_MS:.0f}.\n")
        print(table(cells))
        print(f"\n{found['verdict']}" + "".join(f"\n{text}" for text in found["errors"]))
    return Verdict(found["verdict"]).exit_code
