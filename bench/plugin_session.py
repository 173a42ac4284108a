"""What the plugin's fixtures do: fly into one run folder, journal every flight, hold results to limits."""

import os
import signal
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from bench.flight_summary import METRIC_UNITS, trial_verdict
from bench.fly import close_run, find_runner, input_hashes, keep_flight
from bench.journal import FILE_NAME, Journal
from bench.provenance import git_state, versions
from bench.spare import stack_threads
from bench.store import Run, Store, runs_root
from bench.verdict import Check, Limit, Measurement, Verdict, check, check_rate, find_limits, load_limits, worst
from saranga.errors import UsageError
from sitl.trial_types import Faults, TrialRequest, TrialResult

FaultsGiven = Faults | Mapping[str, Any] | Iterable[str] | None


class BenchSession:
    """The flights of one pytest process. The run folder is made at the first flight, not before."""

    def __init__(self, config: pytest.Config) -> None:
        self.config = config
        out = config.getoption("--bench-runs")
        self.store = Store(runs_root(Path(out) if out else None))
        self.run: Run | None = None
        self._journal: Journal | None = None
        self._users: set[str] = set()
        self._interrupted = False
        self._flights = 0

    def fly(self, request: TrialRequest, nodeid: str) -> TrialResult:
        """Fly one trial and keep it."""
        journal = self.journal(nodeid)
        assert self.run is not None
        self._flights += 1
        beside = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
        request = replace(request, workdir=self.run.folder / f"autopilot-{request.seed}-{self._flights}",
                          stack_threads=stack_threads(beside))
        assert request.workdir is not None
        request.workdir.mkdir()
        journal.append("request", test=nodeid, request=request.to_dict(), sha256=input_hashes(request))
        try:
            result = find_runner(live=False)(request, None, None)
        except (pytest.exit.Exception, KeyboardInterrupt) as error:
            self._interrupted = True
            journal.append("interrupted", test=nodeid, signal=str(error) or "SIGINT")
            raise
        keep_flight(self.run.folder, journal, request, result, record=True, note=lambda text: None)
        return result

    def journal(self, nodeid: str) -> Journal:
        """The journal, made now if this is the first that happens; `nodeid` is the test that asks."""
        self._users.add(nodeid)
        if self._journal is None:
            arguments = [str(a) for a in self.config.invocation_params.args]
            self.run = self.store.create("test", f"pytest {' '.join(arguments)}".strip(), argv=arguments)
            self._journal = Journal(self.run.folder / FILE_NAME)
            self._journal.append(
                "header",
                format=1,
                run_kind="test",
                run=str(self.run.folder),
                argv=arguments,
                versions=versions(),
                git=git_state(),
            )
        return self._journal

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Journal how each test that flew ended."""
        if self._journal is not None and report.nodeid in self._users and (report.when == "call" or report.failed):
            text = report.longreprtext.splitlines()[-1:] if report.failed else []
            self._journal.append(
                "test", test=report.nodeid, outcome=report.outcome, when=report.when, text="".join(text)
            )

    def close(self) -> None:
        """Write the summary."""
        if self._journal is None or self.run is None:
            return
        state = "interrupted" if self._interrupted else "finished"
        self._journal.append("end", state=state)
        self._journal.close()
        self._journal = None
        close_run(self.store, self.run, state)


@contextmanager
def open_session(config: pytest.Config) -> Iterator[BenchSession]:
    """A session whose teardown also happens when CI ends pytest with SIGTERM or SIGHUP."""
    session = BenchSession(config)
    config.pluginmanager.register(session, "saranga-bench-session")
    before: dict[signal.Signals, Any] = {}

    def leave(number: int, frame: FrameType | None) -> None:
        pytest.exit(signal.Signals(number).name, returncode=128 + number)

    if threading.current_thread() is threading.main_thread():
        before = {s: signal.signal(s, leave) for s in (signal.SIGTERM, signal.SIGHUP)}
    try:
        yield session
    finally:
        for name, handler in before.items():
            signal.signal(name, handler)
        session.close()
        config.pluginmanager.unregister(session)


class Flight:
    """The `flight` fixture."""

    def __init__(self, session: BenchSession, autopilot: str, node: pytest.Item) -> None:
        self._session = session
        self._node = node
        self.autopilot = autopilot
        self.first_seed = int(session.config.getoption("--bench-seed"))

    def __call__(self, scene: str, seed: int | None = None, faults: FaultsGiven = None, **what: Any) -> TrialResult:
        """Fly one trial.

        Args:
            scene: name in fixtures/scenes, or a path.
            seed: --bench-seed when left out.
            faults: `Faults`, a mapping, or texts such as "echo_silent_at_s=12".
            what: other fields of `TrialRequest`, such as stack, denoiser, shield.

        Raises:
            UsageError: a field there is not, or anything the trial refuses.
            DeviceError: the autopilot cannot be started.
        """
        denoiser = self._session.config.getoption("--bench-denoiser")
        if denoiser is not None:
            what.setdefault("denoiser", denoiser)
        try:
            request = TrialRequest(
                scene=scene,
                seed=self.first_seed if seed is None else seed,
                autopilot=self.autopilot,
                faults=_faults(faults),
                **what,
            )
        except TypeError as error:
            raise UsageError(f"flight(): {error}; known are the fields of TrialRequest") from None
        result = self._session.fly(request, self._node.nodeid)
        run = self._session.run
        self._node.user_properties += [
            (
                "bench_flight",
                f"{result.scene} seed {result.seed}: {result.outcome}" + (f" ({result.cause})" if result.cause else ""),
            ),
            ("bench_autopilot", "{kind} {version}".format(**{"version": "", **result.autopilot}).strip()),
            ("bench_origin", "simulated"),
            ("bench_seed", result.seed),
            ("bench_hash", result.determinism_hash),
            ("bench_git", git_state()["commit"] or "unknown"),
            ("bench_run", str(run.folder) if run else ""),
        ]
        return result

    def many(self, scene: str, trials: int, **what: Any) -> list[TrialResult]:
        """Fly `trials` (or --bench-trials) seeds from --bench-seed on."""
        asked = self._session.config.getoption("--bench-trials")
        count = trials if asked is None else int(asked)
        if count < 1:
            raise UsageError(f"--bench-trials {count}: at least 1")
        return [self(scene, seed=self.first_seed + n, **what) for n in range(count)]


def _faults(given: FaultsGiven) -> Faults | None:
    if given is None or isinstance(given, Faults):
        return given
    texts = [f"{k}={v}" for k, v in given.items()] if isinstance(given, Mapping) else given
    return Faults.parse(texts)


class NotAccepted(AssertionError):
    """A check whose verdict is not PASS or MARGINAL."""


class Accept:
    """The `accept` fixture."""

    def __init__(self, node: pytest.Item) -> None:
        self._node = node

    def __call__(
        self,
        what: TrialResult | Sequence[TrialResult] | Measurement | float | None,
        limit: Limit | None = None,
        limits: str | None = None,
    ) -> Check:
        """Hold flights or a value to a limit.

        Args:
            what: flights (their success is held to the limit), or a value. A bare number counts as simulated.
            limit: the limit. Flights may do without: several use the limits of their scene if there are any,
                else each of them must be clean and landed.
            limits: name of a file in fixtures/limits, or a path, to take the rate's limit from.

        Returns:
            The check, PASS or MARGINAL.

        Raises:
            NotAccepted: any other verdict, INCONCLUSIVE and ERROR included.
            UsageError: a value without a limit, or a limit that does not fit.
        """
        __tracebackhide__ = True
        got = judge(what, limit, limits)
        self._node.user_properties.append(("bench_verdict", f"{got.name} {got.verdict.value}: {got.why}"))
        if not got.verdict.accepted:
            reason = f"\n  the limit's reason: {got.reason} [{got.source}]" if got.reason else ""
            raise NotAccepted(f"{got.verdict.value}: {got.name}, held to {got.limit}: {got.why}{reason}")
        return got


def judge(what: Any, limit: Limit | None = None, limits: str | None = None) -> Check:
    """The check behind `accept`, without raising when it is not accepted."""
    if isinstance(what, TrialResult):
        what = [what]
    if isinstance(what, Sequence) and all(isinstance(w, TrialResult) for w in what):
        return _judge_flights(what, limit, limits)
    if isinstance(what, Sequence):
        raise UsageError("accept(): a list must hold the results of flights and nothing else")
    if limit is None:
        raise UsageError("accept(): a value needs limit=Limit(...): nothing passes that is held to nothing")
    value = what if isinstance(what, Measurement) or what is None else Measurement(float(what), limit.unit)
    return check(value, limit)


def _judge_flights(flights: Sequence[TrialResult], limit: Limit | None, limits: str | None) -> Check:
    verdicts = [trial_verdict(f.to_dict()) for f in flights]
    wrong = [
        f"seed {f.seed}: {f.outcome} ({f.cause or 'landed: ' + str(f.landed)})"
        for f, v in zip(flights, verdicts, strict=True)
        if v is not Verdict.PASS
    ]
    if limit is None:
        name = limits or (find_limits(flights[0].scene) if len(flights) > 1 else None)
        found = [x for x in load_limits(name, tuple(METRIC_UNITS)) if x.is_rate] if name is not None else []
        if limits is not None and not found:
            raise UsageError(f"accept(): limits {limits!r} hold no success rate")
        limit = found[0] if found else None
    broken = not flights or any(v in (Verdict.ERROR, Verdict.INCONCLUSIVE) for v in verdicts)
    if limit is None or broken:
        why = "; ".join(wrong) or (f"all {len(flights)} clean" if flights else "no flights")
        return Check("flights", worst(verdicts), None, "", "every flight clean and landed", why)
    if not limit.is_rate:
        raise UsageError(f"accept(): {limit.name} is no rate: pass the value itself, not the flights")
    strict = limit.name == "success_rate_strict"
    return check_rate(sum(f.success_strict if strict else f.success_lenient for f in flights), len(flights), limit)
