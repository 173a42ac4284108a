"""Run folders and their index: found by any sensible name, several processes at once, index disposable."""

import os
import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest

from bench.store import Store, age_text, read_run, runs_root
from saranga.errors import BenchError, UsageError


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "runs")


def make(store: Store, title: str = "poles", verdict: str = "PASS") -> str:
    run = store.create("fly", title, seeds=[1])
    store.finish(run, "finished", verdict, {"outcomes": ["clean"]})
    return run.id


def test_root_from_option_then_environment_then_here(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SARANGA_BENCH_RUNS", raising=False)
    assert runs_root() == Path("runs")
    monkeypatch.setenv("SARANGA_BENCH_RUNS", "/data/runs")
    assert runs_root() == Path("/data/runs")
    assert runs_root(Path("x")) == Path("x")


def test_runs_newest_first_with_verdict(store: Store) -> None:
    ids = [make(store, f"scene{n}") for n in range(4)]
    got = store.runs()
    assert [r.id for r in got] == ids[::-1]
    assert got[0].info["verdict"] == "PASS"
    assert got[0].info["summary"] == {"outcomes": ["clean"]}
    assert [r.id for r in store.runs(limit=2)] == ids[:1:-1]
    assert read_run(got[0].folder).info["inputs"] == {"seeds": [1]}  # type: ignore[union-attr]


def test_index_is_rebuilt_from_folders(store: Store) -> None:
    ids = {make(store) for _ in range(3)}
    (store.root / "index.sqlite").unlink()
    assert {r.id for r in store.runs()} == ids
    (store.root / "index.sqlite").write_bytes(b"this is not a database at all" * 100)
    assert {r.id for r in store.runs()} == ids
    with sqlite3.connect(store.root / "index.sqlite") as connection:
        connection.execute("DELETE FROM runs")
    assert store.rebuild_index() == 3
    assert {r.id for r in store.runs()} == ids


def test_damaged_index_does_not_stop_a_run(store: Store) -> None:
    make(store)
    for name in ("index.sqlite-wal", "index.sqlite-shm"):
        (store.root / name).unlink(missing_ok=True)
    (store.root / "index.sqlite").write_bytes(b"x" * 5000)
    make(store)
    assert len(store.runs()) == 2


def test_folder_removed_by_hand_is_forgotten(store: Store) -> None:
    import shutil

    gone, stays = make(store), make(store)
    shutil.rmtree(store.resolve(gone))
    assert [r.id for r in store.runs()] == [stays]


def test_resolve_by_last_id_prefix_folder_and_path(store: Store) -> None:
    first, last = make(store), make(store)
    folder = store.resolve(first)
    assert store.resolve("last").name.endswith(last)
    for name in (folder.name, str(folder), str(folder / "run.json"), first[:5] if first[:5] != last[:5] else first):
        assert store.resolve(name) == folder
    with pytest.raises(UsageError, match="ambiguous"):
        store.resolve("2")  # every folder name starts with the year
    with pytest.raises(UsageError, match="no run 'zzz'"):
        store.resolve("zzz")


def test_last_of_nothing_says_what_to_do(store: Store) -> None:
    with pytest.raises(UsageError, match="fly one with"):
        store.resolve("last")


def test_a_run_whose_process_died_is_shown_as_interrupted(store: Store) -> None:
    code = (
        f"from bench.store import Store; from pathlib import Path; import os\n"
        f"print(Store(Path({str(store.root)!r})).create('fly', 'poles').id, flush=True); os._exit(9)"
    )
    run_id = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip()
    ours = store.create("fly", "poles")
    states = {r.id: (r.info["state"], r.info["verdict"]) for r in store.runs()}
    assert states == {run_id: ("interrupted", None), ours.id: ("running", None)}


def test_two_processes_at_once_lose_no_run(store: Store) -> None:
    code = (
        f"from bench.store import Store; from pathlib import Path\n"
        f"s = Store(Path({str(store.root)!r}))\n"
        f"for n in range(20):\n"
        f"    s.finish(s.create('fly', f'p{{n}}'), 'finished', 'PASS', {{}}); s.runs(3)\n"
    )
    workers = [subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.PIPE, text=True) for _ in range(3)]
    for worker in workers:
        _, said = worker.communicate(timeout=100)
        assert worker.returncode == 0, said
    with sqlite3.connect(store.root / "index.sqlite") as connection:
        assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        assert connection.execute("SELECT count(*) FROM runs WHERE verdict = 'PASS'").fetchone() == (60,)
    assert len(store.runs()) == 60


def test_a_place_that_cannot_be_written_is_one_clear_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(BenchError, match="--out"):
        Store(tmp_path / "file").create("fly", "poles")


def test_run_file_is_never_half_written(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    run = store.create("fly", "poles")
    monkeypatch.setattr(os, "fsync", lambda _: (_ for _ in ()).throw(OSError(28, "No space left on device")))
    with pytest.raises(BenchError, match="No space left"):
        store.finish(run, "finished", "PASS", {})
    assert read_run(run.folder).info["state"] == "running"  # type: ignore[union-attr]


def test_age() -> None:
    assert age_text("2020-01-01T00:00:00.000000Z").endswith(" d ago")
