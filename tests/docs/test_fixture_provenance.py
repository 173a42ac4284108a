"""Every fixture has a provenance, and every provenance a fixture."""

import fnmatch
import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "fixtures.md"


def test_every_fixture_says_where_it_comes_from() -> None:
    rows = [line.split("|") for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("| `")]
    patterns = [pattern for row in rows for pattern in re.findall(r"`([^`]+)`", row[1])]
    assert patterns and all(row[2].strip() and row[3].strip() for row in rows)
    files = [str(p.relative_to(ROOT / "fixtures")) for p in sorted((ROOT / "fixtures").rglob("*"))
             if p.is_file() and "__pycache__" not in p.parts]
    unknown = [file for file in files if not any(fnmatch.fnmatch(file, pattern) for pattern in patterns)]
    unused = [pattern for pattern in patterns if not fnmatch.filter(files, pattern)]
    assert not unknown, f"docs/fixtures.md does not say where these come from: {unknown}"
    assert not unused, f"docs/fixtures.md names what is not there: {unused}"


def test_pages_link_to_pages_that_exist() -> None:
    for page in [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]:
        for link in re.findall(r"\]\(([^)#:]+)\)", page.read_text(encoding="utf-8")):
            assert (page.parent / link).exists(), f"{page.name} links to {link}, which is not there"
