"""The examples of docs/your-own-stack.md are real: they load, and they meet the contract."""

import re
from pathlib import Path

import pytest

pytest_plugins = ["pytester"]
DOCUMENT = Path(__file__).resolve().parents[2] / "docs" / "your-own-stack.md"


def test_the_documents_examples_meet_the_contract(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("PYTEST_ADDOPTS", raising=False)
    blocks = re.findall(r"```python\n(.*?)```", DOCUMENT.read_text(encoding="utf-8"), re.DOTALL)
    assert len(blocks) == 2
    pytester.makepyfile(mine="\n".join(blocks))
    result = pytester.runpytest_subprocess(
        "-p", "no:cacheprovider", "-p", "no:benchmark", "-p", "no:xdist", "--bench-contract", "mine:Careful",
        "--bench-contract", "mine:Loudest", "-k", "not quick_enough", timeout=120)
    assert result.ret == 0, result.stdout.str()
    result.stdout.fnmatch_lines(["*mine:Careful is a policy", "*mine:Loudest is a denoiser"])
