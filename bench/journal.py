"""The run's journal: append-only JSON lines, each on disk before the next step begins.

Everything a report says is rebuilt from here, so a run that was killed still has one. A line cut off by the
death of its writer was never acknowledged: it is dropped when reading, and cut away when the journal goes on.
"""

import json
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from saranga.errors import BenchError, UsageError

FORMAT = 1
FILE_NAME = "journal.jsonl"


def utc_now() -> str:
    """Now in UTC as ISO 8601 with microseconds, which also sorts."""
    seconds, fraction = divmod(time.time(), 1)
    return time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(seconds)) + f".{int(fraction * 1e6):06d}Z"


class Journal:
    """Writer; one per run folder. `append` returns once the record is on disk."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
        self._cut_torn_tail()
        _sync_folder(path.parent)

    def append(self, kind: str, **fields: Any) -> None:
        """Write one record.

        Raises:
            BenchError: the disk refused it (full, gone); what was written before stays.
        """
        record = {"kind": kind, "utc": utc_now(), **fields}
        line = json.dumps(record, allow_nan=False, default=str, separators=(",", ":")) + "\n"
        data = line.encode("utf-8")
        try:
            while data:  # one write almost always; a full disk may take only a part of it
                data = data[os.write(self._fd, data) :]
            os.fsync(self._fd)
        except OSError as error:
            raise BenchError(
                f"{self.path}: cannot be written ({error.strerror}): free some space; the records "
                "before this one are safe"
            ) from error

    def close(self) -> None:
        """May be called twice."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def _cut_torn_tail(self) -> None:
        data = self.path.read_bytes()
        if data and not data.endswith(b"\n"):
            os.truncate(self._fd, data.rfind(b"\n") + 1)


@contextmanager
def open_journal(path: Path, **header: Any) -> Iterator[Journal]:
    """A journal that begins with a header record (format, versions, what was asked)."""
    journal = Journal(path)
    try:
        if path.stat().st_size == 0:
            journal.append("header", format=FORMAT, **header)
        yield journal
    finally:
        journal.close()


@dataclass
class Records:
    """What was read: the header, the records after it, whether the last line was cut, and lines nobody can read."""

    header: dict[str, Any] = field(default_factory=dict)
    records: list[dict[str, Any]] = field(default_factory=list)
    torn: bool = False
    damaged_lines: list[int] = field(default_factory=list)

    def of(self, kind: str) -> list[dict[str, Any]]:
        """Records of one kind, in order."""
        return [r for r in self.records if r.get("kind") == kind]

    @property
    def end(self) -> dict[str, Any] | None:
        """The closing record, None when the run never came to its end."""
        ends = self.of("end")
        return ends[-1] if ends else None


def read_journal(path: Path) -> Records:
    """Read a journal, whole or cut off anywhere.

    Raises:
        UsageError: no such file, nothing readable in it, or a format this version does not know.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror}; give a run folder with a journal") from error
    found = Records(torn=bool(data) and not data.endswith(b"\n"))
    lines = data.split(b"\n")[:-1]
    for number, line in enumerate(lines, start=1):
        try:
            record = json.loads(line)
        except ValueError:
            record = None
        if not isinstance(record, dict) or "kind" not in record:
            found.damaged_lines.append(number)
        elif record["kind"] == "header" and not found.header:
            found.header = record
        else:
            found.records.append(record)
    if not found.header:
        raise UsageError(f"{path}: has no readable header: the run died before it began, or this is no journal")
    if found.header.get("format") != FORMAT:
        raise UsageError(f"{path}: journal format {found.header.get('format')}, this version reads {FORMAT}")
    return found


def _sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
