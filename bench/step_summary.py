"""The summary of a CI step: `summary.md` in the run folder, and the file GitHub shows on the job's page."""

import contextlib
import os
from pathlib import Path

FILE = "summary.md"


def publish_step_summary(folder: Path, text: str, append: bool = False) -> None:
    """Write (or append to) `summary.md`, and append to $GITHUB_STEP_SUMMARY where that is set.

    A step summary that cannot be written fails no flight. Raises OSError only for the run folder's own file.
    """
    with (folder / FILE).open("a" if append else "w", encoding="utf-8") as file:
        file.write(text)
    step = os.environ.get("GITHUB_STEP_SUMMARY")
    if step:
        with contextlib.suppress(OSError), Path(step).open("a", encoding="utf-8") as file:
            file.write(text)


def cell(text: object) -> str:
    """Text that breaks neither a table nor the page."""
    return str(text).replace("|", "\\|").replace("\n", " ").replace("<", "&lt;")
