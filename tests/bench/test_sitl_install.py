"""`saranga-bench sitl`: downloads from a real HTTP server on this machine, cut off, changed, and absent."""

import json
import os
import stat
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

import bench.sitl_install
from bench.binaries import inspect_binary
from bench.cli import main
from bench.sitl_install import install
from saranga.errors import DeviceError, UsageError
from sitl.autopilot.binary import arducopter_path, why_absent

PATH = "/Copter/stable-4.5.7/SITL_x86_64_linux_gnu/arducopter"
MACHINE = {"x86_64": 0x3E, "aarch64": 0xB7}[os.uname().machine]


def elf(version: bytes = b"ArduCopter V4.5.7 (abcdef12)", machine: int = MACHINE, size: int = 900_000) -> bytes:
    """Enough of an ELF executable to be recognised, with a version text in the middle."""
    head = b"\x7fELF\x02\x01\x01" + bytes(9) + (2).to_bytes(2, "little") + machine.to_bytes(2, "little") + bytes(44)
    body = bytes(range(256)) * (size // 256)
    return head + body[: size // 2] + b"\0" + version + b"\0" + body[size // 2 :]


class Server:
    """Serves files with ranges, and can cut a connection after some bytes."""

    def __init__(self) -> None:
        self.files: dict[str, bytes] = {}
        self.cuts: list[int] = []
        self.ranges = True
        self.status: int | None = None
        self.log: list[tuple[str, str | None, int]] = []
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                outer.answer(self)

            def log_message(self, *_: Any) -> None:
                pass

        self._http = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self._http.server_address[1]}"
        threading.Thread(target=self._http.serve_forever, daemon=True).start()

    def answer(self, request: BaseHTTPRequestHandler) -> None:
        data = self.files.get(request.path)
        asked = request.headers.get("Range")
        if data is None or self.status is not None:
            self.log.append((request.path, asked, self.status or 404))
            request.send_error(self.status or 404)
            return
        tag = f'"{hash(data)}"'
        start = int(asked.removeprefix("bytes=").rstrip("-")) if asked and self.ranges else 0
        if request.headers.get("If-Range", tag) != tag:
            start = 0
        if start >= len(data):
            self.log.append((request.path, asked, 416))
            request.send_error(416)
            return
        self.log.append((request.path, asked, 206 if start else 200))
        request.send_response(206 if start else 200)
        if start:
            request.send_header("Content-Range", f"bytes {start}-{len(data) - 1}/{len(data)}")
        request.send_header("Content-Length", str(len(data) - start))
        request.send_header("ETag", tag)
        request.end_headers()
        piece = data[start : start + self.cuts.pop(0)] if self.cuts else data[start:]
        request.wfile.write(piece)

    def close(self) -> None:
        self._http.shutdown()
        self._http.server_close()


@pytest.fixture
def server() -> Iterator[Server]:
    serving = Server()
    serving.files[PATH] = elf()
    yield serving
    serving.close()


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(bench.sitl_install, "PAUSE_S", 0.0)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.delenv("ARDUCOPTER", raising=False)
    for name in ("http_proxy", "HTTP_PROXY"):
        monkeypatch.delenv(name, raising=False)


def test_download_whole_executable_and_remembered(server: Server, tmp_path: Path) -> None:
    done = install("4.5.7", server.url)
    assert done.path == tmp_path / "home" / ".cache" / "saranga-bench" / "arducopter" == arducopter_path()
    assert done.path.read_bytes() == elf()
    assert done.path.stat().st_mode & stat.S_IXUSR
    assert json.loads((done.path.parent / "checksums.json").read_text()) == {server.url + PATH: done.sha256}
    assert why_absent() is None
    assert not list(done.path.parent.glob("*.part*"))
    assert inspect_binary(done.path).version == "V4.5.7"
    again = install("4.5.7", server.url)
    assert (again.downloaded, again.sha256, len(server.log)) == (False, done.sha256, 1)


def test_cut_connections_go_on_where_they_stopped(server: Server) -> None:
    server.cuts = [300_000, 100_000]
    done = install("4.5.7", server.url)
    assert done.path.read_bytes() == elf()
    assert [(r, s) for _, r, s in server.log] == [(None, 200), ("bytes=300000-", 206), ("bytes=400000-", 206)]


def test_the_next_command_goes_on_too(server: Server, tmp_path: Path) -> None:
    server.cuts = [200_000, 0, 0, 0, 0]
    with pytest.raises(DeviceError, match=r"broke off.*200000 bytes are kept: run the command again"):
        install("4.5.7", server.url)
    assert not arducopter_path().exists()
    assert install("4.5.7", server.url).path.read_bytes() == elf()
    assert server.log[-1][1:] == ("bytes=200000-", 206)


def test_file_that_changed_on_the_server_is_begun_anew(server: Server) -> None:
    server.cuts = [200_000, 0, 0, 0, 0]
    with pytest.raises(DeviceError):
        install("4.5.7", server.url)
    server.files[PATH] = elf(size=700_000)
    assert install("4.5.7", server.url).path.read_bytes() == elf(size=700_000)


def test_server_without_ranges_is_begun_anew(server: Server) -> None:
    server.cuts, server.ranges = [200_000], False
    assert install("4.5.7", server.url).path.read_bytes() == elf()


def test_another_checksum_is_refused_until_forced(server: Server) -> None:
    first = install("4.5.7", server.url)
    first.path.unlink()
    server.files[PATH] = elf(b"ArduCopter V4.5.7 (tampered)")
    with pytest.raises(DeviceError, match=rf"differs from {first.sha256}.*--force"):
        install("4.5.7", server.url)
    assert not first.path.exists()
    assert not list(first.path.parent.glob("*.part*"))
    assert install("4.5.7", server.url, force=True).sha256 != first.sha256


def test_a_binary_swapped_on_disk_is_downloaded_again(server: Server) -> None:
    done = install("4.5.7", server.url)
    done.path.write_bytes(b"something else")
    assert install("4.5.7", server.url).downloaded
    assert done.path.read_bytes() == elf()


def test_folder_without_stable_in_its_name(server: Server) -> None:
    server.files = {PATH.replace("stable-", ""): elf()}
    assert "/Copter/4.5.7/" in install("4.5.7", server.url).url


def test_unknown_release_names_the_version_and_the_address(server: Server) -> None:
    with pytest.raises(DeviceError, match=r"ArduCopter 9\.9\.9 is not published at http.*stable-9\.9\.9.*404"):
        install("9.9.9", server.url)


def test_server_trouble_names_its_answer(server: Server) -> None:
    server.status = 503
    with pytest.raises(DeviceError, match="answered 503"):
        install("4.5.7", server.url)


def test_offline_names_address_cause_and_what_to_do(server: Server) -> None:
    server.close()
    with pytest.raises(DeviceError, match=r"stable-4\.5\.7.*Connection refused.*--base-url.*ARDUCOPTER"):
        install("4.5.7", server.url)


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"<html>log in to the hotel's network</html>" * 9, "not a Linux executable"),
        (elf(b"ArduPlane V4.5.7"), "is ArduPlane V4.5.7, wrong firmware"),
        (elf(b"Rover V4.5.7"), "is Rover V4.5.7, wrong firmware"),
        (elf(b"nothing"), "no ArduPilot version text"),
        (elf(machine=0x28), "built for arm and this machine"),
    ],
)
def test_what_is_not_arducopter_for_this_machine_is_not_installed(server: Server, data: bytes, says: str) -> None:
    server.files[PATH] = data
    with pytest.raises(DeviceError, match=says):
        install("4.5.7", server.url)
    assert not arducopter_path().exists()


@pytest.mark.parametrize(
    ("version", "base"),
    [
        ("../../etc", "https://x"),
        ("", "https://x"),
        ("4.5.7", "http://firmware.ardupilot.org"),
        ("4.5.7", "ftp://x"),
        ("4.5.7", "firmware.ardupilot.org"),
        ("4.5.7", "file:///etc"),
    ],
)
def test_addresses_that_cannot_be_are_refused(version: str, base: str) -> None:
    with pytest.raises(UsageError):
        install(version, base)


# ---- the commands -------------------------------------------------------------------------------
def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    try:
        main(["sitl", *arguments])
        code = 0
    except SystemExit as ended:
        code = int(ended.code or 0)
    out, err = capsys.readouterr()
    return code, out, err


def test_install_command_prints_one_object(server: Server, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = run(capsys, "install", "--base-url", server.url, "--json")
    assert code == 0
    assert json.loads(out)["bytes"] == len(elf())
    assert "0.9 MB" in err, "the size is told"
    code, out, _ = run(capsys, "where")
    assert (code, out.strip()) == (0, str(arducopter_path()))


def test_without_a_binary_where_and_check_say_how_to_get_it(capsys: pytest.CaptureFixture[str]) -> None:
    for what in ("where", "check"):
        code, out, err = run(capsys, what)
        assert (code, out) == (4, "")
        assert err.count("\n") == 1
        assert "sitl install" in err


def test_check_starts_the_binary(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """An ELF header that does not run is told from one that does (the machine's own `true` says no --model)."""
    path = tmp_path / "arducopter"
    monkeypatch.setenv("ARDUCOPTER", str(path))
    path.write_bytes(elf())
    assert "not executable" in run(capsys, "check")[2]
    path.chmod(0o755)
    code, _, err = run(capsys, "check")
    assert code == 4
    assert "cannot be started" in err or "ended with" in err
    path.write_bytes(Path("/bin/true").resolve().read_bytes() + b"\0ArduCopter V4.6.0\0")
    code, _, err = run(capsys, "check")
    assert code == 4
    assert "--help ended with 0" in err


def test_check_says_wrong_firmware(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    path = tmp_path / "arduplane"
    path.write_bytes(elf(b"ArduPlane V4.6.1"))
    path.chmod(0o755)
    monkeypatch.setenv("ARDUCOPTER", str(path))
    code, _, err = run(capsys, "check", "--json")
    assert code == 4
    assert "ArduPlane V4.6.1, wrong firmware: ArduCopter is needed" in err


@pytest.mark.real_arducopter
def test_check_of_the_real_binary(
    capsys: pytest.CaptureFixture[str], real_path: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ARDUCOPTER", real_path)
    code, out, _ = run(capsys, "check", "--json")
    assert code == 0
    got = json.loads(out)
    assert (got["verdict"], got["vehicle"]) == ("PASS", "ArduCopter")


REAL = why_absent(), str(arducopter_path())


@pytest.fixture
def real_path() -> str:
    reason, path = REAL
    if reason is not None:
        pytest.skip(reason)
    return path
