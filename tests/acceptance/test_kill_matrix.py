"""The kill matrix: however a run is cut off, the throttle idles within 200 ms, the record stays, nothing passes.

A real sweep in its own process, the real supervisor, an emulated device behind a real port that logs what it applies.
What a machine that is too busy cannot tell is skipped with the reason, never passed.
"""

from pathlib import Path

import pytest

from bench.supervisor.causes import CAUSES, PHASES
from bench.supervisor.kill_matrix import QUICK, Cell, run_matrix
from bench.supervisor.matrix_report import table
from bench.verdict import Verdict

pytestmark = [pytest.mark.wall_time, pytest.mark.xdist_group("wall_time")]
REST = [(cause, phase) for cause in CAUSES for phase in PHASES if (cause, phase) not in QUICK]


@pytest.fixture(scope="module")
def quick_cells(tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[str, str], Cell]:
    found = run_matrix(QUICK, tmp_path_factory.mktemp("matrix") / "cells", jobs=2)
    print(table(found))
    return {(cell.cause, cell.phase): cell for cell in found}


def judge(cell: Cell) -> None:
    if cell.verdict is Verdict.INCONCLUSIVE:
        pytest.skip(f"INCONCLUSIVE: {cell.why}")
    assert cell.verdict is Verdict.PASS, cell.why
    assert cell.ms_to_idle <= 200.0 and cell.resumed and cell.steps_kept >= 1
    assert cell.verdict_of_run not in ("PASS", "MARGINAL") and cell.control_exit != 0


def test_the_quick_cells_hold_every_cause_and_every_phase() -> None:
    assert {cause for cause, _ in QUICK} == set(CAUSES)
    assert {phase for _, phase in QUICK} == set(PHASES)


@pytest.mark.timeout(600)
@pytest.mark.parametrize(("cause", "phase"), QUICK)
def test_the_throttle_idles_and_the_run_can_go_on(quick_cells: dict[tuple[str, str], Cell], cause: str,
                                                  phase: str) -> None:
    judge(quick_cells[cause, phase])


@pytest.mark.timeout(600)
def test_the_same_plan_passes_once_it_has_come_to_its_end(quick_cells: dict[tuple[str, str], Cell]) -> None:
    """Else "never PASS" would say nothing."""
    assert [cell for cell in quick_cells.values() if cell.verdict_resumed == "PASS"]


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_the_rest_of_the_matrix_holds(tmp_path: Path) -> None:
    cells = run_matrix(REST, tmp_path / "cells", jobs=2)
    print(table(cells))
    wrong = [f"{c.cause} in {c.phase}: {c.why}" for c in cells if c.verdict is Verdict.FAIL]
    assert not wrong, "\n".join(wrong)
    unclear = [f"{c.cause} in {c.phase}: {c.why}" for c in cells if c.verdict is not Verdict.PASS]
    if unclear:
        pytest.skip("INCONCLUSIVE: " + "; ".join(unclear))
