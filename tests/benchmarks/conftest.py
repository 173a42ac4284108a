"""Tables that the benchmarks want read: printed together at the end, after pytest-benchmark's own."""

from typing import Any

import pytest

TABLES = pytest.StashKey[list[str]]()


@pytest.fixture(scope="session")
def tables(request: pytest.FixtureRequest) -> list[str]:
    """Append a table (text) to have it printed when all is done."""
    return request.config.stash.setdefault(TABLES, [])


@pytest.hookimpl(trylast=True)
def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    for table in config.stash.get(TABLES, []):
        terminalreporter.write_line("\n" + table)
