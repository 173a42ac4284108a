"""Trips that stay latched between runs: one small file a throttle, removed only by the operator."""

import hashlib
import json
import os
from pathlib import Path

from bench.journal import utc_now
from bench.supervisor.guard import Trip
from saranga.errors import BenchError


def state_folder() -> Path:
    """`$XDG_STATE_HOME/saranga-bench/trips`, by default in ~/.local/state."""
    return Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state") / "saranga-bench" / "trips"


class Latches:
    """The latched trips of one throttle in one folder; no folder: they last as long as this object.

    A file that cannot be read counts as a trip: what was in it is unknown.
    """

    def __init__(self, folder: Path | None, throttle_url: str) -> None:
        self._path = None if folder is None else folder / f"trips-{_digest(throttle_url)}.json"
        self._url = throttle_url

    def load(self) -> list[Trip]:
        """What is latched."""
        if self._path is None or not self._path.exists():
            return []
        return read_latch(self._path)[1]

    def save(self, trips: list[Trip]) -> None:
        """Write them, all of them, so that a power cut leaves the old or the new.

        Raises:
            BenchError: the folder cannot be written.
        """
        if self._path is None:
            return
        text = json.dumps({"throttle_url": self._url, "utc": utc_now(),
                           "trips": [{"name": t.name, "text": t.text} for t in trips]})
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            new = self._path.with_suffix(".new")
            with new.open("w", encoding="utf-8") as file:
                file.write(text + "\n")
                file.flush()
                os.fsync(file.fileno())
            new.replace(self._path)
        except OSError as error:
            raise BenchError(f"{self._path}: trips cannot be latched on disk: {error.strerror}; mend the folder before "
                             "anything spins") from error

    def remove(self) -> None:
        """Only for the operator's clear."""
        if self._path is not None:
            self._path.unlink(missing_ok=True)


def read_latch(path: Path) -> tuple[str, list[Trip]]:
    """Throttle URL and trips of one file."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        return str(data["throttle_url"]), [Trip(str(t["name"]), str(t["text"])) for t in data["trips"]]
    except (OSError, ValueError, KeyError, TypeError) as error:
        return "?", [Trip("latch", f"{path} cannot be read ({error}): what tripped is unknown")]


def all_latches(folder: Path) -> dict[Path, tuple[str, list[Trip]]]:
    """Every latch file of a folder."""
    return {path: read_latch(path) for path in sorted(folder.glob("trips-*.json"))}


def _digest(url: str) -> str:
    return hashlib.sha256(url.encode()).hexdigest()[:16]
