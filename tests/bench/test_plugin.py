"""The pytest plugin, in pytest sessions of its own, over scripted flights."""

import json
import os
import signal
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
import scipy.stats  # noqa: F401 - pytester forgets what is first imported inside its tests; numpy.fft loads only once
from fake_flights import SCENE

from bench.flight_summary import summarise
from bench.journal import read_journal
from bench.store import Run, Store

pytest_plugins = ["pytester"]
PLAIN = ("-p", "no:cacheprovider", "-p", "no:benchmark", "-p", "no:hypothesispytest")
HERE = Path(__file__).parent
NO_BINARY = {"ARDUCOPTER": "/nowhere/arducopter"}
CONFTEST = f"""
import sys
sys.path.insert(0, {str(HERE)!r})
import fake_flights
flights = fake_flights.install({{script!r}})
"""


class Project:
    """A project of tests that uses the plugin; pytest runs in a process of its own."""

    def __init__(self, pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> None:
        self.pytester, self._patch = pytester, monkeypatch
        self.runs = pytester.path / "runs"
        (pytester.path / "corridor.toml").write_text(SCENE)

    def run(self, script: str, test: str, *arguments: str, **environment: str) -> pytest.RunResult:
        self.write(script, test)
        for name, value in environment.items():
            self._patch.setenv(name, value)
        return self.pytester.runpytest_subprocess(*PLAIN, *arguments, timeout=60)

    def write(self, script: str, test: str) -> None:
        self.pytester.makeconftest(CONFTEST.format(script=script))
        self.pytester.makepyfile(test)

    def only_run(self) -> Run:
        (run,) = Store(self.runs).runs()
        return run


@pytest.fixture
def project(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> Project:
    monkeypatch.delenv("SARANGA_BENCH_RUNS", raising=False)
    monkeypatch.delenv("PYTEST_ADDOPTS", raising=False)
    return Project(pytester, monkeypatch)


def test_a_flight_is_flown_kept_and_accepted(project: Project) -> None:
    result = project.run(
        "clean",
        """
        def test_it(flight, accept):
            got = flight("./corridor.toml", seed=5, stack="none", faults=["dead_sensor=left"])
            assert (got.seed, got.stack, got.autopilot["kind"]) == (5, "none", "embedded")
            accept(got)
    """,
        "--junitxml=j.xml",
        "-o",
        "junit_family=xunit1",
    )
    result.assert_outcomes(passed=1)
    run = project.only_run()
    assert (run.info["kind"], run.info["verdict"], run.info["state"]) == ("test", "PASS", "finished")
    assert (run.folder / "flight-5.npz").is_file()
    journal = read_journal(run.folder / "journal.jsonl")
    (trial,) = journal.of("trial")
    assert trial["request"]["faults"] == {"dead_sensor": "left"}
    assert [t["outcome"] for t in journal.of("test")] == ["passed"]
    case = ElementTree.parse(project.pytester.path / "j.xml").getroot().find(".//testcase")
    assert case is not None
    said = {p.get("name"): p.get("value") for p in case.iter("property")}
    assert said["bench_seed"] == "5"
    assert said["bench_hash"] == trial["result"]["determinism_hash"]
    assert said["bench_origin"] == "simulated"
    assert said["bench_verdict"] == "flights PASS: all 1 clean"
    assert said["bench_run"] == str(run.folder.relative_to(project.pytester.path))


@pytest.mark.parametrize(
    ("script", "verdict"),
    [
        ("obstacle_hit", "FAIL"),
        ("infrastructure", "ERROR"),
        ("interrupted", "INCONCLUSIVE"),
    ],
)
def test_anything_but_a_clean_flight_fails_the_test_with_the_reason(
    project: Project, script: str, verdict: str
) -> None:
    result = project.run(
        script,
        """
        def test_it(flight, accept):
            accept(flight("./corridor.toml"))
    """,
    )
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(
        [f"E*{verdict}: flights, held to every flight clean and landed: seed 1: {script} (because of {script})"]
    )
    assert project.only_run().info["verdict"] == "FAIL"


def test_flights_are_held_to_a_rate(project: Project) -> None:
    result = project.run(
        ",".join(["clean"] * 10 + ["clean"] * 3 + ["stuck"] * 10),
        """
        from bench.verdict import Limit
        LIMIT = Limit("success_rate_strict", "1", lo=0.6, reason="paper", source="table 2")
        def test_pass(flight, accept):
            assert accept(flight.many("./corridor.toml", 10), limit=LIMIT).verdict == "PASS"
        def test_inconclusive(flight, accept):
            accept(flight.many("./corridor.toml", 3), limit=LIMIT)
        def test_fail(flight, accept):
            accept(flight.many("./corridor.toml", 10), limit=LIMIT)
    """,
    )
    result.assert_outcomes(passed=1, failed=2)
    result.stdout.fnmatch_lines(
        [
            "E*INCONCLUSIVE: success_rate_strict, held to >= 0.6: 3 of 3*about 3 more would decide",
            "E*the limit's reason: paper *table 2*",
            "E*FAIL: success_rate_strict*0 of 10*",
        ]
    )


def test_values_fail_closed(project: Project) -> None:
    result = project.run(
        "",
        """
        import math, pytest
        from bench.verdict import Limit, Measurement
        from saranga.errors import UsageError
        LIMIT = Limit("t", "s", hi=1.0, reason="r", source="s")
        REAL = Limit("t", "s", hi=1.0, reason="r", source="s", requires="measured")
        def test_good(accept):
            accept(0.5, limit=LIMIT)
            accept(Measurement(0.5, "s", "measured"), limit=REAL)
        @pytest.mark.parametrize("value", [None, math.nan, 2.0, Measurement(0.5, "ms")])
        def test_bad(accept, value):
            accept(value, limit=LIMIT)
        def test_simulated(accept):
            accept(0.5, limit=REAL)
        def test_empty(accept):
            accept([])
        def test_held_to_nothing(accept):
            with pytest.raises(UsageError):
                accept(0.5)
    """,
    )
    result.assert_outcomes(passed=2, failed=6)
    assert not project.runs.exists(), "no flight, no run folder"


def test_options_set_seed_trials_denoiser_and_folder(project: Project) -> None:
    result = project.run(
        "clean,clean,clean",
        """
        def test_it(flight):
            got = flight.many("./corridor.toml", 10)
            assert [(g.seed, g.denoiser) for g in got] == [(7, "gaussian"), (8, "gaussian")]
            assert flight("./corridor.toml", denoiser="tbd").denoiser == "tbd"
    """,
        "--bench-seed=7",
        "--bench-trials=2",
        "--bench-denoiser=gaussian",
        "--bench-runs=elsewhere",
    )
    result.assert_outcomes(passed=1)
    (run,) = Store(project.pytester.path / "elsewhere").runs()
    assert sorted(p.name for p in run.folder.glob("*.npz")) == ["flight-7-1.npz", "flight-7.npz", "flight-8.npz"]


TWO = """
    import pytest
    def test_any(flight):
        flight("./corridor.toml")
    @pytest.mark.real_arducopter
    def test_real(flight):
        assert flight("./corridor.toml").autopilot["kind"] == "arducopter"
"""


def test_without_the_binary_real_flights_are_skipped_with_the_reason(project: Project) -> None:
    result = project.run("clean", TWO, "-rs", **NO_BINARY)
    result.assert_outcomes(passed=1, skipped=1)
    result.stdout.fnmatch_lines(["SKIPPED*ArduCopter SITL binary not found at /nowhere/arducopter*sitl install*"])
    assert result.ret == 0


@pytest.mark.parametrize(("asked", "passed", "skipped"), [("arducopter", 0, 2), ("both", 1, 2)])
@pytest.mark.parametrize("workers", [(), ("-n", "1")])
def test_asked_for_the_real_one_and_all_skipped_is_not_green(
    project: Project, asked: str, passed: int, skipped: int, workers: tuple[str, ...]
) -> None:
    result = project.run("clean", TWO, f"--bench-autopilot={asked}", *workers, **NO_BINARY)
    result.assert_outcomes(passed=passed, skipped=skipped)
    assert result.ret == 4
    result.stdout.fnmatch_lines(["*arducopter was asked for, and every flight on it was skipped*"])


def test_with_a_binary_both_autopilots_fly(project: Project) -> None:
    result = project.run("clean,clean,clean", TWO, "--bench-autopilot=both", ARDUCOPTER=sys.executable)
    result.assert_outcomes(passed=3)
    assert result.ret == 0


def test_sigterm_ends_the_session_with_the_run_written(project: Project) -> None:
    project.write(
        "clean,deaf",
        """
        def test_one(flight):
            flight("./corridor.toml")
        def test_two(flight):
            flight("./corridor.toml")
        def test_three(flight):
            raise SystemExit("never comes to this")
    """,
    )
    session = subprocess.Popen(
        [sys.executable, "-m", "pytest", "-s", "-p", "no:cacheprovider"],
        text=True,
        cwd=project.pytester.path,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        env={**os.environ},
    )
    assert session.stdout is not None
    for line in session.stdout:
        if "flying" in line:
            break
    session.send_signal(signal.SIGTERM)
    out, _ = session.communicate(timeout=20)
    assert session.returncode == 128 + signal.SIGTERM
    assert "SIGTERM" in out
    run = project.only_run()
    assert (run.info["state"], run.info["verdict"]) == ("interrupted", "INCONCLUSIVE")
    assert [o["outcome"] for o in summarise(read_journal(run.folder / "journal.jsonl"))["outcomes"]] == ["clean"]


def test_a_project_that_does_not_use_it_pays_nothing(pytester: pytest.Pytester) -> None:
    pytester.makepyfile("""
        import signal, sys
        def test_it():
            heavy = {"numpy", "numba", "scipy", "rerun", "bench.fly", "bench.plugin_session", "sitl", "typer"}
            assert not heavy & set(sys.modules)
            assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL
    """)
    result = pytester.runpytest_subprocess(*PLAIN, timeout=60)
    result.assert_outcomes(passed=1)
    # apart from pytest's own list of plugins not a word
    assert "bench" not in result.stdout.str().replace("saranga-bench-0.1.0", "")
    assert not (pytester.path / "runs").exists()


def test_a_field_there_is_not_is_named(project: Project) -> None:
    result = project.run(
        "clean",
        """
        import pytest
        def test_it(flight):
            flight("./corridor.toml", stak="none")
    """,
    )
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*UsageError*unexpected keyword argument 'stak'*"])


def test_run_of_a_session_can_be_listed_as_json(project: Project) -> None:
    project.run("clean", "def test_it(flight):\n    flight('./corridor.toml')\n")
    done = subprocess.run(
        [sys.executable, "-m", "bench.cli", "runs", "--json", "--out", str(project.runs)],
        capture_output=True,
        text=True,
        timeout=20,
    )
    (row,) = json.loads(done.stdout)["runs"]
    assert (row["kind"], row["verdict"], row["summary"]["outcomes"]) == ("test", "PASS", ["clean"])
