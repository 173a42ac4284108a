"""Where runs live: `runs/<utc>-<kind>-<id>/`, and an index of them that can be thrown away at any time.

The folders are the truth. `index.sqlite` (WAL, one short transaction a change) only makes listing fast; it is
rebuilt from the folders when it is missing or damaged, and several processes may use it at once.
"""

import contextlib
import json
import os
import re
import secrets
import sqlite3
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.journal import utc_now
from saranga.errors import BenchError, UsageError

RUN_FILE = "run.json"
INDEX_FILE = "index.sqlite"
FOLDER_NAME = re.compile(r"^\d{8}T\d{6}Z-[a-z0-9_]+-[0-9a-f]{6}$")
BUSY_MS = 20_000
SCHEMA = """CREATE TABLE IF NOT EXISTS runs (
    id TEXT PRIMARY KEY, folder TEXT NOT NULL, kind TEXT, started_utc TEXT, finished_utc TEXT, state TEXT,
    pid INTEGER, title TEXT, verdict TEXT, summary TEXT)"""
COLUMNS = (
    "id",
    "folder",
    "kind",
    "started_utc",
    "finished_utc",
    "state",
    "pid",
    "title",
    "verdict",
    "summary",
)


def runs_root(out: Path | None = None) -> Path:
    """`out`, else `$SARANGA_BENCH_RUNS`, else `./runs`."""
    return out or Path(os.environ.get("SARANGA_BENCH_RUNS") or "runs")


@dataclass
class Run:
    """One run folder and what its `run.json` says."""

    folder: Path
    info: dict[str, Any]

    @property
    def id(self) -> str:
        """Six hexadecimal digits, the end of the folder's name."""
        return str(self.info["id"])


class Store:
    """Runs under one root folder. Safe to use from several processes at once."""

    def __init__(self, root: Path) -> None:
        self.root = root

    # ---- writing ---------------------------------------------------------------------------------
    def create(self, kind: str, title: str, **inputs: Any) -> Run:
        """A fresh folder, with `run.json` and an index entry in state "running".

        Raises:
            BenchError: the folder cannot be made.
        """
        started = utc_now()
        stamp = started[:19].replace("-", "").replace(":", "") + "Z"
        for _ in range(100):
            run_id = secrets.token_hex(3)
            folder = self.root / f"{stamp}-{kind}-{run_id}"
            try:
                folder.mkdir(parents=True)
                break
            except FileExistsError as error:
                if not self.root.is_dir():
                    raise BenchError(f"{self.root} is not a folder: choose another with --out") from error
            except OSError as error:
                raise BenchError(
                    f"{folder}: cannot be made: {error.strerror}; choose another place with --out"
                ) from error
        else:
            raise BenchError(f"{self.root}: no free run name found; is its clock standing still?")
        info = {
            "id": run_id,
            "kind": kind,
            "title": title,
            "started_utc": started,
            "finished_utc": None,
            "state": "running",
            "pid": os.getpid(),
            "verdict": None,
            "summary": None,
            "inputs": inputs,
        }
        run = Run(folder, info)
        self._write(run)
        return run

    def finish(self, run: Run, state: str, verdict: str, summary: dict[str, Any]) -> None:
        """Close a run: state is "finished", "interrupted" or "crashed"."""
        run.info.update(state=state, verdict=verdict, summary=summary, finished_utc=utc_now())
        self._write(run)

    def discard(self, run: Run) -> None:
        """Remove the folder of a run that never began (bad input), and its index entry."""
        import shutil

        shutil.rmtree(run.folder, ignore_errors=True)
        with contextlib.suppress(sqlite3.Error), self._index() as connection:
            connection.execute("DELETE FROM runs WHERE id = ?", (run.id,))

    def _write(self, run: Run) -> None:
        write_json(run.folder / RUN_FILE, run.info)
        with contextlib.suppress(sqlite3.Error), self._index() as connection:  # folders are the truth
            _put(connection, run)

    # ---- reading ---------------------------------------------------------------------------------
    def runs(self, limit: int | None = None) -> list[Run]:
        """Newest first. A run whose process died without closing it is shown as "interrupted", no verdict."""
        if not self.root.is_dir():
            return []
        try:
            rows = self._rows()
        except sqlite3.Error:
            rows = [_row(run) for run in self._read_folders()]
        runs = [_from_row(self.root, row) for row in rows]
        runs.sort(key=lambda run: str(run.info["started_utc"]), reverse=True)
        return runs[:limit] if limit is not None else runs

    def rebuild_index(self) -> int:
        """Write the index anew from the folders; returns how many runs it holds."""
        runs = self._read_folders()
        with self._lock():
            self._remove_index()
        with self._index() as connection:
            for run in runs:
                _put(connection, run)
        return len(runs)

    def resolve(self, name: str) -> Path:
        """Folder of a run given as `last`, its id, the start of its id or folder name, or a path.

        Raises:
            UsageError: nothing fits, or more than one run does.
        """
        path = Path(name).expanduser()
        if path.is_file():
            path = path.parent
        if (path / RUN_FILE).is_file():
            return path
        runs = self.runs()
        if name == "last":
            if runs:
                return runs[0].folder
            raise UsageError(
                f"no runs in {self.root}: fly one with `saranga-bench fly poles`, or name another folder with --out"
            )
        fits = [r for r in runs if r.folder.name == name or r.id == name] or [
            r for r in runs if r.folder.name.startswith(name) or r.id.startswith(name)
        ]
        if len(fits) == 1:
            return fits[0].folder
        if fits:
            raise UsageError(
                f"run {name!r} is ambiguous: {', '.join(r.folder.name for r in fits[:6])}; give more of it"
            )
        raise UsageError(f"no run {name!r} in {self.root}: `saranga-bench runs` lists them; `last` is the newest")

    def _read_folders(self) -> list[Run]:
        found = []
        for folder in sorted(self.root.iterdir()):
            if FOLDER_NAME.match(folder.name):
                run = read_run(folder)
                if run is not None:
                    found.append(run)
        return found

    def _rows(self) -> list[tuple[Any, ...]]:
        """Rows of the index after putting it in step with the folders."""
        names = {f.name for f in self.root.iterdir() if FOLDER_NAME.match(f.name)}
        with self._index() as connection:
            known = {row[1]: row for row in connection.execute(f"SELECT {', '.join(COLUMNS)} FROM runs")}
            for gone in known.keys() - names:
                connection.execute("DELETE FROM runs WHERE folder = ?", (gone,))
            for name in names - known.keys() | {n for n in names & known.keys() if known[n][5] == "running"}:
                run = read_run(self.root / name)
                if run is not None:
                    _put(connection, run)
                    known[name] = _row(run)
        return [row for name, row in known.items() if name in names]

    # ---- the index -------------------------------------------------------------------------------
    @contextlib.contextmanager
    def _index(self) -> Iterator[sqlite3.Connection]:
        """One transaction on the index, made anew first if the file is damaged."""
        try:
            connection = self._connect()
        except sqlite3.OperationalError:  # locked or not writable, which says nothing about the file
            raise
        except sqlite3.DatabaseError:
            with self._lock():
                self._remove_index()
            connection = self._connect()
            for run in self._read_folders():
                _put(connection, run)
            connection.commit()
        try:
            with connection:
                yield connection
        finally:
            connection.close()

    def _connect(self) -> sqlite3.Connection:
        connection = sqlite3.connect(self.root / INDEX_FILE, timeout=BUSY_MS / 1000)
        try:
            if connection.execute("PRAGMA journal_mode").fetchone()[0] != "wal":
                with self._lock():  # two processes switching to WAL at once lock each other out
                    connection.execute("PRAGMA journal_mode=WAL")
            connection.execute(SCHEMA)
        except sqlite3.Error:
            connection.close()
            raise
        return connection

    def _remove_index(self) -> None:
        for suffix in ("", "-wal", "-shm"):
            (self.root / (INDEX_FILE + suffix)).unlink(missing_ok=True)

    @contextlib.contextmanager
    def _lock(self) -> Iterator[None]:
        from filelock import FileLock

        with FileLock(self.root / ".index.lock", timeout=BUSY_MS / 1000):
            yield


def read_run(folder: Path) -> Run | None:
    """The run in a folder, None when its `run.json` is absent or damaged."""
    try:
        info = json.loads((folder / RUN_FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    if not isinstance(info, dict) or "id" not in info or "started_utc" not in info:
        return None
    return Run(folder, info)


def write_json(path: Path, data: Any) -> None:
    """Write JSON whole or not at all: other file, fsync, rename.

    Raises:
        BenchError: the disk refused it.
    """
    part = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        with part.open("w", encoding="utf-8") as file:
            json.dump(data, file, indent=1, allow_nan=False, default=str)
            file.write("\n")
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    except OSError as error:
        raise BenchError(f"{path}: cannot be written: {error.strerror}; free some space or use --out") from error


def process_alive(pid: int | None) -> bool:
    """Whether a process of that number runs (ours or another user's)."""
    if not pid:
        return False
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def age_text(utc: str) -> str:
    """How long ago an ISO 8601 UTC time was, such as "3 min ago"."""
    import calendar

    seconds = time.time() - calendar.timegm(time.strptime(utc[:19], "%Y-%m-%dT%H:%M:%S"))
    for size, name in ((86_400, "d"), (3_600, "h"), (60, "min")):
        if seconds >= size:
            return f"{int(seconds // size)} {name} ago"
    return "just now"


def _row(run: Run) -> tuple[Any, ...]:
    info = run.info
    return (
        info["id"],
        run.folder.name,
        info.get("kind"),
        info["started_utc"],
        info.get("finished_utc"),
        info.get("state"),
        info.get("pid"),
        info.get("title"),
        info.get("verdict"),
        json.dumps(info.get("summary")),
    )


def _put(connection: sqlite3.Connection, run: Run) -> None:
    marks = ", ".join("?" * len(COLUMNS))
    connection.execute(f"INSERT OR REPLACE INTO runs ({', '.join(COLUMNS)}) VALUES ({marks})", _row(run))


def _from_row(root: Path, row: tuple[Any, ...]) -> Run:
    info = dict(zip(COLUMNS, row, strict=True))
    folder = root / info.pop("folder")
    info["summary"] = json.loads(info["summary"]) if info["summary"] else None
    if info["state"] == "running" and not process_alive(info["pid"]):
        info["state"] = "interrupted"
    return Run(folder, info)
