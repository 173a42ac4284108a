"""The operator's side: confirming, listing and clearing trips, choosing cells of the kill matrix."""

import io
import json
from pathlib import Path

import pytest

from bench.cli import main
from bench.supervisor.device_log import DeviceLog, phase
from bench.supervisor.guard import Trip
from bench.supervisor.kill_matrix import Cell
from bench.supervisor.latches import Latches
from bench.supervisor.matrix_report import chosen_cells, summary, table
from bench.supervisor.plan import Confirmation
from saranga.errors import UsageError


def test_only_the_typed_word_confirms() -> None:
    assert Confirmation.from_operator("a propeller", ask=lambda text: "SPIN ").text == "SPIN"
    for typed in ("spin", "", "yes", "SPIN!"):
        with pytest.raises(UsageError, match="nothing spins"):
            Confirmation.from_operator("a propeller", ask=lambda text, typed=typed: typed)


def test_nobody_at_the_terminal_confirms_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("SPIN\n"))
    with pytest.raises(UsageError, match="nobody is at a terminal"):
        Confirmation.from_operator("a propeller")


def test_trips_are_listed_and_not_cleared_without_an_operator(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                                              capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    folder = tmp_path / "saranga-bench" / "trips"
    Latches(folder, "teensy+serial:///dev/ttyACM0").save([Trip("rpm", "rpm 30000 1/min is beyond 20000 1/min")])
    with pytest.raises(SystemExit) as ended:
        main(["supervisor", "trips", "--json"])
    assert ended.value.code == 0
    [found] = json.loads(capsys.readouterr().out)["latched"]
    assert found["throttle_url"].endswith("ttyACM0") and found["trips"][0]["name"] == "rpm"
    monkeypatch.setattr("sys.stdin", io.StringIO("CLEAR\n"))
    with pytest.raises(SystemExit) as ended:
        main(["supervisor", "clear"])
    assert ended.value.code == 2 and list(folder.glob("trips-*.json"))


def test_an_unknown_cell_is_refused_by_name() -> None:
    assert chosen_cells(["SIGKILL"], ["hold"], quick=False) == [("SIGKILL", "hold")]
    assert len(chosen_cells([], [], quick=False)) == 36
    for causes, phases in ((["SIGKIL"], []), ([], ["hover"])):
        with pytest.raises(UsageError, match="known are"):
            chosen_cells(causes, phases, quick=False)
    with pytest.raises(UsageError, match="no cell"):
        chosen_cells(["SIGKILL"], ["idle"], quick=True)


def cell(**what: object) -> Cell:
    return Cell(**{"cause": "SIGKILL", "phase": "hold", "ms_to_idle": 60.0, "resumed": True, **what})  # type: ignore


@pytest.mark.parametrize("what,verdict", [
    ({}, "PASS"), ({"ms_to_idle": 201.0}, "FAIL"), ({"ms_to_idle": 201.0, "late_ms": 80.0}, "INCONCLUSIVE"),
    ({"ms_to_idle": float("inf"), "late_ms": 80.0}, "FAIL"), ({"dead_man_ms": 170.0}, "FAIL"),
    ({"faults": ["journal lost"], "late_ms": 80.0}, "FAIL"), ({"starved": True}, "INCONCLUSIVE")])
def test_a_cell_never_passes_when_anything_is_missing(what: dict[str, object], verdict: str) -> None:
    assert cell(**what).verdict.value == verdict
    assert summary([cell(), cell(**what)])["verdict"] == verdict
    assert (verdict in table([cell(**what)])) == (verdict != "PASS")


def test_a_cell_that_never_ran_is_no_pass() -> None:
    assert Cell("SIGKILL", "hold").verdict.value == "FAIL"
    assert "never FAIL" in table([Cell("SIGKILL", "hold")])


def test_the_device_log_knows_phases_and_when_idle_began(tmp_path: Path) -> None:
    path = tmp_path / "truth.jsonl"
    log = DeviceLog(path)
    log.read()
    assert log.idle_since_s() is not None and phase(log, 0.4) == ""
    seen = []
    steps = [0.0] * 6 + [0.04 * k for k in range(1, 11)] + [0.4] * 6
    steps += [0.4 - 0.04 * k for k in range(1, 10)] + [0.0] * 6
    with path.open("w") as file:
        for k, value in enumerate(steps):
            event = "dead_man" if k == 31 else "command"
            file.write(json.dumps({"t_s": k * 0.02, "event": event, "applied": round(value, 3)}) + "\n")
            file.flush()
            log.read()
            found = phase(log, 0.4)
            seen += [found] if found and (not seen or seen[-1] != found) else []
        file.write('{"t_s": 9.0, "event": "comm')
        file.flush()
        log.read()
    assert seen == ["ramp", "hold", "ramp-down", "idle"]
    assert log.idle_since_s() == pytest.approx(31 * 0.02) and log.dead_man_s == [pytest.approx(0.62)]
    assert log.last_command_before(0.62) == pytest.approx(0.60)
