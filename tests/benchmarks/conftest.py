"""Tables that the benchmarks want read: printed together at the end, after pytest-benchmark's own."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from synthetic_images import Reflector, image

from saranga.denoise import load_denoiser

TABLES = pytest.StashKey[list[str]]()


@pytest.fixture(scope="session")
def tables(request: pytest.FixtureRequest) -> list[str]:
    """Append a table (text) to have it printed when all is done."""
    return request.config.stash.setdefault(TABLES, [])


@pytest.fixture
def denoiser_within(benchmark: Any) -> Callable[[str, float], None]:
    """Time one denoiser by name on eight images in turn; its median must be within the limit, milliseconds an image."""

    def run(name: str, limit_ms: float) -> None:
        pictures = [image([Reflector(0.5, 1.0), Reflector(0.9, 0.8)], 10.0, np.random.default_rng(i)) for i in range(8)]
        denoiser = load_denoiser(name)
        denoiser(pictures[0])  # type: ignore[arg-type]
        turn = iter(range(10**9))
        benchmark(lambda: denoiser(pictures[next(turn) % 8]))  # type: ignore[arg-type]
        assert benchmark.stats["median"] * 1e3 <= limit_ms

    return run


@pytest.hookimpl(trylast=True)
def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    for table in config.stash.get(TABLES, []):
        terminalreporter.write_line("\n" + table)
