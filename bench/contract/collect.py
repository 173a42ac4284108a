"""Brings the contract's tests into a pytest session that asked for them, and tells at the end what was held to what."""

from pathlib import Path
from typing import Any

import pytest

from bench.contract.subject import DENOISER, POLICY, Subject, find_subjects
from saranga.errors import UsageError

FILES = {DENOISER: "denoiser_contract.py", POLICY: "policy_contract.py"}


class ContractPlugin:
    """Registered by `bench.plugin` when --bench-contract is given."""

    def __init__(self, config: pytest.Config, specs: list[str]) -> None:
        try:
            self.subjects = find_subjects(specs)
        except UsageError as error:
            raise pytest.UsageError(str(error)) from None
        self.latencies: list[str] = []
        folder = Path(__file__).parent
        kinds = {subject.kind for subject in self.subjects}
        files = [str(folder / FILES[kind]) for kind in FILES if kind in kinds]
        # Paths that were typed are run as well; without any, only the contract is, not the whole of testpaths.
        typed = config.args_source is pytest.Config.ArgsSource.ARGS
        config.args[:] = [*(config.args if typed else []), *files]

    def pytest_generate_tests(self, metafunc: pytest.Metafunc) -> None:
        """Every test of the contract comes once for each subject of its kind."""
        for kind, fixture in ((DENOISER, "denoiser_subject"), (POLICY, "policy_subject")):
            if fixture in metafunc.fixturenames:
                chosen = [subject for subject in self.subjects if subject.kind == kind]
                metafunc.parametrize(fixture, chosen, ids=[subject.id for subject in chosen])

    @pytest.fixture
    def report_latency(self, request: pytest.FixtureRequest) -> Any:
        """`report_latency(text)`: into the closing summary and the test's properties."""

        def report(text: str) -> None:
            self.latencies.append(text)
            request.node.user_properties.append(("bench_latency", text))

        return report

    def pytest_report_header(self) -> list[str]:
        return [f"bench contract: {subject.spec} is a {subject.kind}" for subject in self.subjects]

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        if self.latencies:
            terminalreporter.section("bench contract: latency, measured on this computer")
            for text in self.latencies:
                terminalreporter.write_line(text)


__all__ = ["ContractPlugin", "Subject"]
