"""`saranga-bench fly` over scripted flights: verdicts, exit codes, JSON, errors, interruption."""

import json
import os
import signal
import subprocess
import sys
import time
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import pytest
from fake_flights import SCENE, ScriptedFlights, command, make_log, make_result

import bench.fly
from bench.cli import main
from bench.flight_summary import summarise, trial_verdict
from bench.fly import rebuild
from bench.journal import read_journal
from bench.store import Store
from bench.verdict import Verdict
from sitl.trial_types import OUTCOMES, FlightLog, TrialRequest

LIMITS = """
[limits.success_rate_strict]
unit = "1"
at_least = 0.6
reason = "for this test"
source = "this test"
"""
CONTRACT = {"verdict", "outcomes", "metrics", "provenance", "run"}
METRICS = {
    "success_rate",
    "success_rate_strict",
    "success_interval",
    "realtime_factor",
    "determinism_hash",
    "trials_needed",
}


@pytest.fixture
def scene(tmp_path: Path) -> str:
    path = tmp_path / "corridor.toml"
    path.write_text(SCENE)
    return str(path)


@pytest.fixture
def limits(tmp_path: Path) -> str:
    path = tmp_path / "limits.toml"
    path.write_text(LIMITS)
    return str(path)


class Cli:
    """Runs the command in this process over scripted flights."""

    def __init__(self, root: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
        self.root, self._patch, self._capsys = root, monkeypatch, capsys
        self.err = ""

    def __call__(self, script: str, *arguments: str) -> tuple[int, str]:
        self.flights = ScriptedFlights(script)
        self._patch.setattr(bench.fly, "find_runner", lambda live: self.flights)
        self._patch.setenv("SARANGA_BENCH_RUNS", str(self.root))
        with pytest.raises(SystemExit) as ended:
            main(["fly", "--no-record", *arguments])
        out, self.err = self._capsys.readouterr()
        return int(ended.value.code or 0), out

    def json(self, script: str, *arguments: str) -> tuple[int, dict[str, Any]]:
        code, out = self(script, "--json", *arguments)
        assert out.count("\n") == 1, "exactly one JSON object on stdout"
        return code, json.loads(out)


@pytest.fixture
def cli(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Cli:
    return Cli(tmp_path / "runs", monkeypatch, capsys)


@pytest.mark.parametrize(
    ("outcome", "verdict", "code"),
    [
        ("clean", "PASS", 0),
        ("net_hit", "FAIL", 1),
        ("obstacle_hit", "FAIL", 1),
        ("timeout", "FAIL", 1),
        ("stuck", "FAIL", 1),
        ("estimator_failure", "FAIL", 1),
        ("infrastructure", "ERROR", 4),
        ("never heard of", "ERROR", 4),
    ],
)
def test_one_flight_is_judged_by_its_outcome(
    cli: Cli, scene: str, limits: str, outcome: str, verdict: str, code: int
) -> None:
    got_code, got = cli.json(outcome, scene, "--limits", limits)
    assert (got_code, got["verdict"]) == (code, verdict)
    assert got.keys() >= CONTRACT
    assert got["metrics"].keys() >= METRICS
    assert got["outcomes"][0]["outcome"] == outcome


def test_every_outcome_there_is_has_a_verdict_and_only_one_passes() -> None:
    passing = [o for o in OUTCOMES if trial_verdict({"outcome": o, "success_strict": True}) is Verdict.PASS]
    assert passing == ["clean"]


def test_clean_but_not_landed_fails() -> None:
    assert trial_verdict({"outcome": "clean", "success_strict": False}) is Verdict.FAIL
    assert trial_verdict({"outcome": "clean"}) is Verdict.FAIL
    assert trial_verdict({}) is Verdict.ERROR


@pytest.mark.parametrize(
    ("script", "verdict", "code"),
    [
        (["clean"] * 10, "PASS", 0),
        (["clean"] * 3, "INCONCLUSIVE", 3),
        (["clean"] * 9 + ["net_hit"], "INCONCLUSIVE", 3),
        (["obstacle_hit"] * 10, "FAIL", 1),
        (["clean"] * 30 + ["infrastructure"], "ERROR", 4),
        (["obstacle_hit"] * 10 + ["infrastructure"], "ERROR", 4),
    ],
)
def test_many_flights_are_held_to_the_limit(
    cli: Cli, scene: str, limits: str, script: list[str], verdict: str, code: int
) -> None:
    arguments = (scene, "--limits", limits, "--trials", str(len(script)), "--quiet")
    assert [cli.json(",".join(script), *arguments)[0]] == [code]
    _, got = cli.json(",".join(script), *arguments)
    assert got["verdict"] == verdict
    flown = [s for s in script if s != "infrastructure"]
    assert got["metrics"]["trials"] == len(flown)
    assert got["metrics"]["success_rate_strict"] == flown.count("clean") / len(flown)
    assert got["metrics"]["success_rate"] == (len(flown) - flown.count("obstacle_hit")) / len(flown)


def test_inconclusive_says_how_many_more(cli: Cli, scene: str, limits: str) -> None:
    _, got = cli.json("clean,clean,clean", scene, "--limits", limits, "--trials", "3")
    assert got["metrics"]["trials_needed"] == 3
    assert "3 more" in got["checks"][0]["why"]


def test_many_flights_without_limits_must_all_pass(cli: Cli, scene: str) -> None:
    assert cli.json("clean,clean", scene, "--trials", "2")[1]["verdict"] == "PASS"
    assert cli.json("clean,stuck", scene, "--trials", "2")[1]["verdict"] == "FAIL"


def test_seeds_faults_and_options_reach_the_flight(cli: Cli, scene: str) -> None:
    cli(
        "clean,clean",
        scene,
        "--seed",
        "7",
        "--trials",
        "2",
        "--stack",
        "none",
        "--denoiser",
        "gaussian",
        "--shield",
        "none",
        "--fault",
        "dead_sensor=right",
        "--fault",
        "setpoint_delay_ms=200",
    )
    assert [r.seed for r in cli.flights.requests] == [7, 8]
    first = cli.flights.requests[0]
    assert (first.stack, first.denoiser, first.shield) == ("none", "gaussian", "none")
    assert first.faults is not None
    assert first.faults.to_dict() == {"dead_sensor": "right", "setpoint_delay_ms": 200.0}


def test_provenance_says_that_it_is_simulated_and_by_which_autopilot(cli: Cli, scene: str) -> None:
    _, got = cli.json("clean", scene)
    assert got["provenance"]["autopilot"] == {"kind": "embedded", "version": "0.1", "real_firmware": False}
    assert got["provenance"]["origin"] == "simulated flight, simulated autopilot"
    assert {k: v["origin"] for k, v in got["metrics_detail"].items()}["success_rate"] == "simulated"
    assert len(got["provenance"]["sha256"]["scene"]) == 64
    assert cli.json("clean", scene, "--autopilot", "arducopter")[1]["provenance"]["autopilot"]["real_firmware"]


def test_same_flights_same_hash_and_replay_line_replays(cli: Cli, scene: str) -> None:
    _, one = cli.json("clean,stuck", scene, "--trials", "2", "--fault", "dead_sensor=left")
    _, two = cli.json("clean,stuck", scene, "--trials", "2")
    _, other = cli.json("clean,clean", scene, "--trials", "2")
    assert one["metrics"]["determinism_hash"] == two["metrics"]["determinism_hash"]
    assert one["metrics"]["determinism_hash"] != other["metrics"]["determinism_hash"]
    import shlex

    words = shlex.split(one["outcomes"][1]["replay"])
    assert words[:2] == ["saranga-bench", "fly"]
    cli("stuck", *words[2:])
    assert cli.flights.requests[0].to_dict() | {"seed": 2} == cli.flights.requests[0].to_dict()
    assert cli.flights.requests[0].faults.to_dict() == {"dead_sensor": "left"}  # type: ignore[union-attr]


def test_human_output_leads_with_the_verdict_and_names_the_replay(cli: Cli, scene: str) -> None:
    code, out = cli("clean,obstacle_hit", scene, "--trials", "2")
    assert code == 1
    lines = [line for line in out.splitlines() if "prints to stdout" not in line]
    assert lines[0].startswith("FAIL")
    assert "simulated" in lines[0]
    assert any("because of obstacle_hit" in line for line in lines)
    assert any(line.strip().startswith("again: saranga-bench fly") and "--seed 2" in line for line in lines)
    assert "seed 1: takeoff" in cli.err
    assert "seed 1: PASS clean" in cli.err


def test_quiet_is_quiet(cli: Cli, scene: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bench.fly.is_cold", lambda: False)  # that it compiles now is worth a line even so
    cli.json("clean", scene, "--quiet")
    assert cli.err.splitlines() == ["a library that prints to stdout"]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("polez",), "unknown scene 'polez'"),
        (("/nowhere/x.toml",), "does not exist"),
        (("SCENE", "--autopilot", "ardupilot"), "unknown autopilot 'ardupilot'"),
        (("SCENE", "--trials", "0"), "at least 1"),
        (("SCENE", "--seed", "-1"), "not negative"),
        (("SCENE", "--limits", "nope"), "unknown limit 'nope'"),
        (("SCENE", "--fault", "echo_silent=3"), "did you mean 'echo_silent_at_s'"),
        (("SCENE", "--fault", "echo_silent_at_s"), "has no value"),
        (("SCENE", "--fault", "drop_probability=2"), "at most 1"),
        (("SCENE", "--fault", "drop_probability=nan"), "must be finite"),
        (("SCENE", "--fault", "dead_sensor=up"), "left, right or down"),
        (("SCENE", "--max-sim-s", "nan"), "positive"),
    ],
)
def test_bad_input_is_one_line_exit_2_and_no_run(cli: Cli, scene: str, arguments: tuple[str, ...], says: str) -> None:
    code, got = cli.json("clean", *(scene if a == "SCENE" else a for a in arguments))
    assert code == 2
    assert says in got["error"]
    assert got["verdict"] == "ERROR"
    assert got.keys() >= CONTRACT
    assert cli.err.strip().splitlines() == [f"error: {got['error']}"]
    assert not list(cli.root.glob("*fly*"))


def test_unknown_option_with_json_still_prints_an_object(cli: Cli, scene: str) -> None:
    code, got = cli.json("clean", scene, "--frobnicate")
    assert (code, got["verdict"]) == (2, "ERROR")
    assert "frobnicate" in cli.err


def test_malformed_scene_names_file_and_line(cli: Cli, tmp_path: Path) -> None:
    (tmp_path / "bad.toml").write_text("[scene\nname=")
    code, got = cli.json("clean", str(tmp_path / "bad.toml"))
    assert code == 2
    assert "bad.toml" in got["error"]
    assert "line 1" in got["error"]


def test_bad_input_that_shows_at_the_first_flight_leaves_no_run(cli: Cli, scene: str) -> None:
    code, got = cli.json("usage", scene)
    assert (code, got["error"]) == (2, "unknown denoiser 'x': known are tbd")
    assert not list(cli.root.glob("*fly*"))
    assert Store(cli.root).runs() == []


def test_missing_autopilot_is_an_error_run(cli: Cli, scene: str) -> None:
    code, got = cli.json("clean,device", scene, "--trials", "3")
    assert (code, got["verdict"]) == (4, "ERROR")
    assert got["errors"] == ["ArduCopter SITL binary not found: run `saranga-bench sitl install`"]
    assert [o["outcome"] for o in got["outcomes"]] == ["clean"]
    assert "error: ArduCopter SITL binary not found" in cli.err


def test_a_bug_is_an_error_with_the_traceback_in_the_run(cli: Cli, scene: str) -> None:
    code, got = cli.json("clean,crash", scene, "--trials", "2")
    assert (code, got["verdict"]) == (4, "ERROR")
    crash = Path(got["run"]) / "crash.txt"
    assert "ZeroDivisionError: a bug" in crash.read_text()
    assert str(crash) in got["errors"][0]
    assert "Traceback" not in cli.err
    assert Store(cli.root).runs()[0].info["state"] == "crashed"


def test_a_recording_that_fails_is_a_warning_not_a_lost_flight(
    cli: Cli, scene: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> Path:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(FlightLog, "save", full)
    code, got = cli.json("clean", scene)
    assert (code, got["verdict"]) == (0, "PASS")
    assert "No space left" in got["warnings"][0]


def test_log_and_dataflash_are_kept_in_the_run(
    cli: Cli, scene: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def flying(request: TrialRequest, *_: object) -> Any:
        assert request.workdir is not None
        (request.workdir / "logs").mkdir(parents=True)
        (request.workdir / "logs" / "00000001.BIN").write_bytes(b"dataflash")
        (tmp_path / "console.txt").write_text("outside")
        result = make_result(request, "clean", make_log())
        result.files = {"console": str(tmp_path / "console.txt")}
        return result

    cli("clean", scene)  # sets the folder
    monkeypatch.setattr(bench.fly, "find_runner", lambda live: flying)
    with pytest.raises(SystemExit):
        main(["fly", scene, "--no-record", "--quiet", "--seed", "3"])
    folder = Store(cli.root).resolve("last")
    assert (folder / "flight-3.bin").read_bytes() == b"dataflash"
    assert (folder / "flight-3-console.txt").read_text() == "outside"
    files = json.loads((folder / "summary.json").read_text())["outcomes"][0]["files"]
    assert files == {"console": "flight-3-console.txt", "log": "flight-3.npz", "dataflash": "flight-3.bin"}
    log = FlightLog.load(folder / "flight-3.npz")
    assert log.events == [(0, "armed"), (125_000, "landed")]
    assert (log.envelope_right == make_log().envelope_right).all()


def test_summary_and_junit_are_rebuilt_from_the_journal_alone(cli: Cli, scene: str, limits: str) -> None:
    _, got = cli.json("clean,stuck", scene, "--trials", "2", "--limits", limits)
    folder = Path(got["run"])
    for name in ("summary.json", "junit.xml", "run.json"):
        (folder / name).unlink()
    assert rebuild(folder) == got
    suite = ElementTree.parse(folder / "junit.xml").getroot()[0]
    assert (suite.get("tests"), suite.get("failures"), suite.get("errors")) == ("3", "2", "0")
    assert "stuck" in suite.findall("testcase")[1].find("failure").get("message")  # type: ignore


def test_a_damaged_journal_is_an_error_whatever_it_says(cli: Cli, scene: str) -> None:
    _, got = cli.json("clean,clean", scene, "--trials", "2")
    path = Path(got["run"]) / "journal.jsonl"
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join([lines[0], "garbage\n", *lines[1:]]))
    assert summarise(read_journal(path))["verdict"] == "ERROR"


# ---- interruption, on a real process ------------------------------------------------------------
def start(tmp_path: Path, script: str, *arguments: str) -> subprocess.Popen[str]:
    flying = subprocess.Popen(
        command(script, "fly", *arguments, "--no-record", "--json"),
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "SARANGA_BENCH_RUNS": str(tmp_path / "runs")},
    )
    assert flying.stderr is not None
    for line in flying.stderr:
        if line == "flying\n":
            break
    return flying


@pytest.mark.parametrize("which", [signal.SIGINT, signal.SIGTERM])
def test_first_signal_ends_the_flight_and_keeps_the_finished_ones(
    tmp_path: Path, scene: str, which: signal.Signals
) -> None:
    flying = start(tmp_path, "clean,clean,hang,clean", scene, "--trials", "4")
    flying.send_signal(which)
    out, err = flying.communicate(timeout=20)
    assert flying.returncode == 130
    assert which.name in err
    got = json.loads(out)
    assert [o["outcome"] for o in got["outcomes"]] == ["clean", "clean", "interrupted"]
    assert got["verdict"] == "INCONCLUSIVE"
    assert got["interrupted"] is True
    assert got["metrics"]["trials"] == 2
    (run,) = Store(tmp_path / "runs").runs()
    assert (run.info["state"], run.info["verdict"]) == ("interrupted", "INCONCLUSIVE")


def test_a_failure_seen_before_the_interruption_stays_a_failure(tmp_path: Path, scene: str) -> None:
    flying = start(tmp_path, "stuck,hang", scene, "--trials", "2")
    flying.send_signal(signal.SIGINT)
    out, _ = flying.communicate(timeout=20)
    assert (flying.returncode, json.loads(out)["verdict"]) == (130, "FAIL")


def test_second_signal_leaves_at_once_and_the_run_can_still_be_reported(tmp_path: Path, scene: str) -> None:
    flying = start(tmp_path, "clean,deaf", scene, "--trials", "2")
    flying.send_signal(signal.SIGINT)
    assert flying.stderr is not None
    for line in flying.stderr:
        if "SIGINT" in line:
            break
    flying.send_signal(signal.SIGINT)  # the same press, passed on by a shell: it changes nothing
    time.sleep(0.5)
    assert flying.poll() is None
    flying.send_signal(signal.SIGINT)
    out, _ = flying.communicate(timeout=5)
    assert (flying.returncode, out) == (130, "")
    (run,) = Store(tmp_path / "runs").runs()
    assert run.info["state"] == "interrupted"
    got = rebuild(run.folder)
    assert (got["verdict"], [o["outcome"] for o in got["outcomes"]]) == ("INCONCLUSIVE", ["clean"])


def test_kill_9_leaves_a_run_that_reports_what_was_flown_and_does_not_pass(tmp_path: Path, scene: str) -> None:
    flying = subprocess.run(
        command("clean,clean,kill", "fly", scene, "--trials", "3", "--no-record"),
        capture_output=True,
        timeout=30,
        env={**os.environ, "SARANGA_BENCH_RUNS": str(tmp_path / "runs")},
    )
    assert flying.returncode == -signal.SIGKILL
    (run,) = Store(tmp_path / "runs").runs()
    got = rebuild(run.folder)
    assert [o["outcome"] for o in got["outcomes"]] == ["clean", "clean"]
    assert (got["verdict"], got["interrupted"]) == ("INCONCLUSIVE", True)


def test_help_is_fast_and_imports_nothing_heavy() -> None:
    code = (
        "import sys, bench.cli\ntry: bench.cli.main(['fly', '--help'])\nexcept SystemExit: pass\n"
        "print(sorted({'numpy', 'numba', 'scipy', 'rerun', 'pymavlink', 'pytest'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=20)
    assert done.stdout.splitlines()[-1] == "[]"
    assert "Exit codes: 0 PASS or MARGINAL, 1 FAIL, 2 bad" in done.stdout
