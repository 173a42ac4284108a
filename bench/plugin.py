"""The pytest plugin: flights as fixtures. Silent, and next to free, in projects that do not use it.

Options: --bench-autopilot, --bench-trials, --bench-seed, --bench-denoiser, --bench-runs; --bench-contract brings its
own tests (`bench.contract`). Fixtures: `flight` flies one trial and keeps it in a run folder, `accept` holds results or
values to limits. The work is done in `bench.plugin_session`, imported when the first fixture is used.
"""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from bench.plugin_session import Accept, BenchSession, Flight

CHOICES = ("embedded", "arducopter", "both")
NO_FLIGHT = "bench: arducopter was asked for, and every flight on it was skipped: nothing is proven"


def pytest_addoption(parser: pytest.Parser) -> None:
    """All options begin with --bench- so that they collide with no other plugin's."""
    group = parser.getgroup("saranga-bench", "flights of saranga-bench")
    group.addoption(
        "--bench-autopilot", choices=CHOICES, default=None, help="autopilot of the `flight` fixture (embedded)"
    )
    group.addoption(
        "--bench-trials", type=int, default=None, metavar="N", help="flights of `flight.many` (what the test says)"
    )
    group.addoption("--bench-seed", type=int, default=1, metavar="S", help="first seed (1)")
    group.addoption("--bench-denoiser", default=None, metavar="NAME", help="denoiser where a test names none")
    group.addoption(
        "--bench-contract", action="append", default=None, metavar="MODULE:NAME",
        help="hold your own denoiser or stack (or a shipped one by name) to the contract; repeatable",
    )
    group.addoption("--bench-runs", default=None, metavar="DIR", help="folder for runs ($SARANGA_BENCH_RUNS or ./runs)")


def pytest_configure(config: pytest.Config) -> None:
    """Declare the marker, and count flights for the end of the session."""
    config.addinivalue_line(
        "markers", "real_arducopter: flies the real autopilot; skipped with the reason where its binary is absent"
    )
    config.pluginmanager.register(_Honesty(config), "saranga-bench-honesty")
    contract = config.getoption("--bench-contract")
    if contract:
        from bench.contract.collect import ContractPlugin

        config.pluginmanager.register(ContractPlugin(config, contract), "saranga-bench-contract")


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """`bench_autopilot` (and so `flight`) comes once for each autopilot asked for."""
    if "bench_autopilot" not in metafunc.fixturenames:
        return
    asked = metafunc.config.getoption("--bench-autopilot") or "embedded"
    if metafunc.definition.get_closest_marker("real_arducopter") is not None:
        asked = "arducopter"
    kinds = ("embedded", "arducopter") if asked == "both" else (asked,)
    metafunc.parametrize("bench_autopilot", kinds, indirect=True, scope="session")


def pytest_runtest_setup(item: pytest.Item) -> None:
    """A test of the real autopilot is skipped, with the reason and what to do, where its binary is absent."""
    if item.get_closest_marker("real_arducopter") is not None:
        _skip_without_binary()


def _skip_without_binary() -> None:
    from sitl.autopilot.binary import why_absent

    reason = why_absent()
    if reason is not None:
        pytest.skip(reason)


@pytest.fixture(scope="session")
def bench_autopilot(request: pytest.FixtureRequest) -> str:
    """Kind of the autopilot to fly, embedded or arducopter; skips where the real one is absent."""
    kind = str(request.param)
    if kind == "arducopter":
        _skip_without_binary()
    return kind


@pytest.fixture(scope="session")
def bench_session(request: pytest.FixtureRequest) -> "Iterator[BenchSession]":
    """One run folder for all flights of this pytest process, made at the first one."""
    from bench.plugin_session import open_session

    with open_session(request.config) as session:
        yield session


@pytest.fixture
def flight(request: pytest.FixtureRequest, bench_session: "BenchSession", bench_autopilot: str) -> "Flight":
    """`flight(scene, seed=..., **what)` flies one trial; `flight.many(scene, trials)` several."""
    from bench.plugin_session import Flight

    return Flight(bench_session, bench_autopilot, request.node)


@pytest.fixture
def accept(request: pytest.FixtureRequest) -> "Accept":
    """`accept(results_or_value, limit=...)` passes, or fails the test with verdict, value, limit and reason."""
    from bench.plugin_session import Accept

    return Accept(request.node)


class _Honesty:
    """A session that was asked for the real autopilot and flew it nowhere must not end green."""

    def __init__(self, config: pytest.Config) -> None:
        self._asked = config.getoption("--bench-autopilot") in ("arducopter", "both")
        self._flown = self._skipped = 0
        self._empty = False

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Counts on the xdist controller as well, from the test's name."""
        if not self._asked or "arducopter" not in report.nodeid.partition("[")[2]:
            return
        if report.skipped:
            self._skipped += 1
        elif report.when == "call":
            self._flown += 1

    @pytest.hookimpl(tryfirst=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Turn green into an error."""
        self._empty = self._skipped > 0 and self._flown == 0
        if self._empty and session.exitstatus == pytest.ExitCode.OK:
            session.exitstatus = 4

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        """And say why."""
        if self._empty:
            terminalreporter.write_line(NO_FLIGHT, red=True)
