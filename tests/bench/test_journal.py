"""The journal survives being cut anywhere, and its writer being killed."""

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.journal import Journal, open_journal, read_journal
from saranga.errors import BenchError, UsageError


def write(path: Path, count: int) -> None:
    with open_journal(path, run_kind="test") as journal:
        for number in range(count):
            journal.append("trial", number=number, text="ü\n")


def numbers(path: Path) -> list[int]:
    return [r["number"] for r in read_journal(path).of("trial")]


def test_what_is_written_is_read(tmp_path: Path) -> None:
    write(tmp_path / "j", 3)
    got = read_journal(tmp_path / "j")
    assert got.header["run_kind"] == "test"
    assert [r["number"] for r in got.of("trial")] == [0, 1, 2]
    assert got.of("trial")[0]["text"] == "ü\n"
    assert (got.torn, got.damaged_lines, got.end) == (False, [], None)


@settings(max_examples=60, deadline=None)
@given(cut=st.integers(1, 400))
def test_cut_anywhere_it_keeps_the_whole_records_before(tmp_path_factory: pytest.TempPathFactory, cut: int) -> None:
    path = tmp_path_factory.mktemp("cut") / "j"
    write(path, 4)
    whole = path.read_bytes()
    header_end = whole.index(b"\n") + 1
    keep = max(len(whole) - cut, header_end)
    path.write_bytes(whole[:keep])
    assert numbers(path) == list(range(whole[:keep].count(b"\n") - 1))
    # going on after the cut neither loses what was whole nor glues onto what was torn
    before = numbers(path)
    with open_journal(path, run_kind="other") as journal:
        journal.append("trial", number=99)
    got = read_journal(path)
    assert numbers(path) == [*before, 99]
    assert (got.damaged_lines, got.torn, got.header["run_kind"]) == ([], False, "test")


def test_a_damaged_line_in_the_middle_is_named(tmp_path: Path) -> None:
    path = tmp_path / "j"
    write(path, 3)
    lines = path.read_bytes().split(b"\n")
    lines[2] = b"\x00\xff garbage"
    path.write_bytes(b"\n".join(lines))
    got = read_journal(path)
    assert got.damaged_lines == [3]
    assert numbers(path) == [0, 2]


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "no readable header"),
        (b'{"kind":"header","form', "no readable header"),
        (b'{"kind":"trial"}\n', "no readable header"),
        (b'{"kind":"header","format":99}\n', "format 99"),
    ],
)
def test_a_journal_that_cannot_be_read_says_why(tmp_path: Path, content: bytes, says: str) -> None:
    (tmp_path / "j").write_bytes(content)
    with pytest.raises(UsageError, match=says):
        read_journal(tmp_path / "j")


def test_not_a_number_cannot_get_in(tmp_path: Path) -> None:
    with open_journal(tmp_path / "j") as journal, pytest.raises(ValueError, match="JSON compliant"):
        journal.append("trial", value=float("nan"))
    assert read_journal(tmp_path / "j").records == []


def test_full_disk_is_one_clear_line() -> None:
    journal = Journal.__new__(Journal)
    journal.path, journal._fd = Path("/dev/full"), __import__("os").open("/dev/full", 1)
    with pytest.raises(BenchError, match="No space left"):
        journal.append("trial", number=1)
    journal.close()


def test_kill_9_in_the_middle_loses_nothing_acknowledged(tmp_path: Path) -> None:
    path = tmp_path / "j"
    code = (
        f"from bench.journal import open_journal\nfrom pathlib import Path\n"
        f"with open_journal(Path({str(path)!r})) as j:\n"
        f"    for n in range(10**9):\n        j.append('trial', number=n, pad='x'*500); print(n, flush=True)\n"
    )
    writer = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert writer.stdout is not None
    for line in writer.stdout:
        if int(line) >= 25:
            break
    writer.send_signal(signal.SIGKILL)
    said = [int(line)] + [int(x) for x in writer.stdout.read().split()]
    writer.wait(10)
    got = numbers(path)
    assert got == list(range(len(got)))
    assert len(got) >= said[-1] + 1
    with open_journal(path) as journal:
        journal.append("end")
    assert read_journal(path).end is not None
    assert [json.loads(x)["kind"] for x in path.read_text().splitlines()][-1] == "end"
