"""The tutorials do what they say, command by command, in an empty folder."""

from pathlib import Path

import pytest

from tests.docs.tutorial import Command, missing, run, steps

DOCS = Path(__file__).parents[2] / "docs"
TUTORIALS = sorted(page.name for page in DOCS.glob("tutorial-*.md"))


def test_there_are_the_three() -> None:
    assert TUTORIALS == ["tutorial-ci.md", "tutorial-preflight.md", "tutorial-thrust-bench.md"]


@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", TUTORIALS)
def test_the_tutorial_works_as_written(name: str, tmp_path: Path) -> None:
    assert run(DOCS / name, tmp_path) >= 4


def test_what_is_not_printed_is_missed(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("```toml\n# file a.toml\nx = 1\n```\n```console\n$ cat a.toml\nx = 2\n$ false  # exit 1\n```\n")
    assert steps(page) == [("a.toml", "# file a.toml\nx = 1\n"), Command("cat a.toml", 0, ["x = 2"]),
                           Command("false", 1)]
    assert run(page, tmp_path) == 2
    page.write_text("```console\n$ echo one\ntwo\n```\n")
    with pytest.raises(AssertionError, match="never prints 'two'"):
        run(page, tmp_path)
    page.write_text("```console\n$ false\n```\n")
    with pytest.raises(AssertionError, match="exit 1, not 0"):
        run(page, tmp_path)
    assert missing(["b", "a"], "a\nb\n") == "a"
    assert missing(["GO: 3 checks...", "...", "runs/20260101T000000Z-fly-3fa9c1"],
                   "GO: 88 checks passed\nx\nruns/20261126T213236Z-fly-ffbbe7\n") is None
