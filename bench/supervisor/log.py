"""The supervisor's own log, `supervisor.jsonl` in the run folder: append-only, in the journal's format.

A thread writes it, so that no disk ever holds up the throttle.
"""

import queue
import sys
import threading
from pathlib import Path
from typing import Any

from bench.journal import FORMAT, Journal
from saranga.errors import BenchError

FILE_NAME = "supervisor.jsonl"


class Log:
    """Where nobody named a folder it keeps nothing.

    Raises:
        BenchError: the folder cannot be written.
    """

    def __init__(self, folder: Path | None, **header: Any) -> None:
        self._queue: queue.SimpleQueue[tuple[str, dict[str, Any]] | None] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None
        self.failed: str | None = None
        if folder is None:
            return
        try:
            self._journal = Journal(folder / FILE_NAME)
            if self._journal.path.stat().st_size == 0:
                self._journal.append("header", format=FORMAT, run_kind="supervisor")
        except OSError as error:
            raise BenchError(f"{folder / FILE_NAME}: cannot be written: {error.strerror}") from error
        self._journal.append("start", **header)
        self._thread = threading.Thread(target=self._write, name="supervisor log", daemon=True)
        self._thread.start()

    def add(self, kind: str, **values: Any) -> None:
        """Queue one record; never waits."""
        if self._thread is not None:
            self._queue.put((kind, values))

    def close(self, timeout_s: float = 2.0) -> None:
        """Write what is queued, waiting at most `timeout_s`. May be called twice."""
        if self._thread is not None:
            self._queue.put(None)
            self._thread.join(timeout_s)
            self._thread = None

    def _write(self) -> None:
        while (entry := self._queue.get()) is not None:
            if self.failed is None:
                try:
                    self._journal.append(entry[0], **entry[1])
                except (BenchError, ValueError) as error:
                    self.failed = str(error)
                    print(f"supervisor log: {error}", file=sys.stderr, flush=True)
        self._journal.close()
