"""Downloading ArduPilot's published SITL build of ArduCopter: resumable, checked, whole or not at all.

The server publishes no checksum beside these builds, so the SHA-256 seen at the first download from an
address is remembered in `checksums.json`, and a later download from there must match it.
"""

import contextlib
import http.client
import json
import re
import ssl
import sys
import time
import urllib.error
import urllib.request
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from bench.binaries import inspect_binary
from bench.provenance import sha256_of
from bench.store import write_json
from saranga.errors import DeviceError, UsageError
from sitl.autopilot.binary import cache_dir

TIMEOUT_S = 30.0
ATTEMPTS = 4
MOST_CONNECTIONS = 50
PAUSE_S = 0.5
BLOCK = 1 << 16
ELSE = "or set ARDUCOPTER to the path of an ArduCopter SITL binary that you built from ArduPilot's source"


@dataclass(frozen=True)
class Installed:
    """What is in place now."""

    path: Path
    url: str
    sha256: str
    size: int
    downloaded: bool


class _Missing(Exception):
    """The server answered 404."""


class _Cut(Exception):
    """The connection ended early; what came is kept."""


def install(version: str, base_url: str, force: bool = False, folder: Path | None = None) -> Installed:
    """Put `arducopter` of a release into the cache folder.

    Args:
        version: such as "4.5.7", or a folder of the server such as "stable" or "beta".
        base_url: the firmware server, https (plain http only on this machine).
        force: download although it is there, and take a checksum that differs as the new one.
        folder: instead of `~/.cache/saranga-bench`.

    Raises:
        UsageError: a version or address that cannot be.
        DeviceError: offline, no such release, cut off too often, wrong file, or a checksum that differs.
    """
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]*", version) or ".." in version:
        raise UsageError(f"--version {version!r}: write it as 4.5.7, or stable, beta, latest")
    _check_base(base_url)
    folder = folder or cache_dir()
    folder.mkdir(parents=True, exist_ok=True)
    from filelock import FileLock, Timeout

    try:
        with FileLock(folder / ".install.lock", timeout=0):
            return _install(_addresses(version, base_url), version, force, folder)
    except Timeout:
        raise DeviceError(f"another `sitl install` is at work in {folder}: wait for it") from None


def _install(urls: list[str], version: str, force: bool, folder: Path) -> Installed:
    target, sums = folder / "arducopter", _read_json(folder / "checksums.json")
    if target.is_file() and not force:
        digest = sha256_of(target)
        for url in urls:
            if sums.get(url) == digest:
                return Installed(target, url, digest, target.stat().st_size, downloaded=False)
    part = folder / f"arducopter-{version}.part"
    url = _download_any(urls, version, part)
    digest = sha256_of(part)
    known = sums.get(url)
    if known is not None and known != digest and not force:
        _drop(part)
        raise DeviceError(
            f"{url}: sha256 {digest} differs from {known} seen before; not installed. If ArduPilot has "
            "published it anew, run again with --force"
        )
    try:
        inspect_binary(part)
    except DeviceError:
        _drop(part)
        raise
    part.chmod(0o755)
    write_json(folder / "checksums.json", {**sums, url: digest})
    size = part.stat().st_size
    part.replace(target)
    _drop(part)
    return Installed(target, url, digest, size, downloaded=True)


def _addresses(version: str, base_url: str) -> list[str]:
    """Where a release may be: the server names its folders `stable-4.5.7`, a mirror may say `4.5.7`."""
    names = [f"stable-{version}", version] if version[0].isdigit() else [version]
    return [f"{base_url.rstrip('/')}/Copter/{name}/SITL_x86_64_linux_gnu/arducopter" for name in names]


def _download_any(urls: list[str], version: str, part: Path) -> str:
    for url in urls:
        with contextlib.suppress(_Missing):
            _download(url, part)
            return url
    raise DeviceError(
        f"ArduCopter {version} is not published at {urls[0]} (404): see "
        f"{urls[0].split('/Copter/')[0]}/Copter/ for the releases there are, {ELSE}"
    )


def _download(url: str, part: Path) -> None:
    """Until the file is whole, going on after what is there; gives up when several tries bring nothing."""
    fruitless = 0
    for _ in range(MOST_CONNECTIONS):
        had = _size(part)
        try:
            _fetch(url, part)
            return
        except _Cut as cut:
            cause = str(cut)
        fruitless = 0 if _size(part) > had else fruitless + 1
        _say(f"{url}: cut off at {_size(part) / 1e6:.1f} MB: {cause}")
        if fruitless >= ATTEMPTS:
            break
        time.sleep(PAUSE_S * fruitless)
    raise DeviceError(
        f"{url}: the download broke off: {cause}; {_size(part)} bytes are kept: run the command again to go on"
    )


def _size(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0


def _fetch(url: str, part: Path) -> None:
    """One connection: append to what is there if the server's file is still the same one."""
    notes = part.with_name(part.name + ".json")
    note = _read_json(notes)
    have = _size(part) if note.get("url") == url else 0
    if have and have == note.get("total"):
        return
    headers = {"User-Agent": "saranga-bench", "Accept-Encoding": "identity"}
    if have and note.get("tag"):
        headers |= {"Range": f"bytes={have}-", "If-Range": note["tag"]}
    try:
        response = urllib.request.urlopen(urllib.request.Request(url, headers=headers), timeout=TIMEOUT_S)
    except urllib.error.HTTPError as error:
        error.close()
        if error.code == 404:
            raise _Missing from None
        if error.code == 416:  # what we hold is as long as the file, or longer: begin anew
            _drop(part)
            raise _Cut("the part did not fit the file") from None
        raise DeviceError(f"{url}: the server answered {error.code} {error.reason}: try later, {ELSE}") from None
    except (urllib.error.URLError, OSError, http.client.HTTPException) as error:
        if have or isinstance(error, http.client.HTTPException | ConnectionResetError):
            raise _Cut(_cause(error)) from None
        raise DeviceError(
            f"{url}: cannot be reached: {_cause(error)}: check the network or proxy, use --base-url "
            f"for a mirror, {ELSE}"
        ) from None
    with response:
        start = have if response.status == 206 and _starts_at(response) == have else 0
        if response.status == 206 and start == 0 and have:
            _drop(part)
            raise _Cut("the server sent another piece than was asked for")
        length = response.headers.get("Content-Length")
        total = start + int(length) if length is not None and length.isdigit() else None
        write_json(
            notes,
            {"url": url, "tag": response.headers.get("ETag") or response.headers.get("Last-Modified"), "total": total},
        )
        _receive(response, part, start, total)


def _receive(response: Any, part: Path, start: int, total: int | None) -> None:
    size = f"{total / 1e6:.1f} MB" if total is not None else "size not told"
    _say(f"{response.url}: {size}" + (f", going on at {start / 1e6:.1f} MB" if start else ""))
    have, shown = start, 0
    with part.open("ab" if start else "wb") as file:
        while True:
            try:
                block = response.read(BLOCK)
            except (OSError, http.client.HTTPException) as error:
                raise _Cut(_cause(error)) from None
            if not block:
                break
            try:
                file.write(block)
            except OSError as error:
                raise DeviceError(f"{part}: cannot be written: {error.strerror}: free some space") from error
            have += len(block)
            if total and have * 10 // total > shown and sys.stderr.isatty():
                shown = have * 10 // total
                _say(f"  {shown * 10} %  {have / 1e6:.1f} MB")
    if total is not None and have < total:
        raise _Cut(f"{have} of {total} bytes came")


def _starts_at(response: Any) -> int:
    found = re.match(r"bytes (\d+)-", response.headers.get("Content-Range") or "")
    return int(found[1]) if found else -1


def _check_base(base_url: str) -> None:
    parts = urlsplit(base_url)
    local = parts.hostname in ("127.0.0.1", "::1", "localhost")
    if (parts.scheme != "https" and not (parts.scheme == "http" and local)) or not parts.hostname:
        raise UsageError(f"--base-url {base_url!r}: must be https:// (a program is downloaded from it)")


def _cause(error: BaseException) -> str:
    reason = getattr(error, "reason", None)
    if isinstance(reason, ssl.SSLError):
        return f"TLS: {reason.reason or reason}"
    if isinstance(reason, OSError) and reason.strerror:
        return str(reason.strerror)
    return str(reason or error) or type(error).__name__


def _drop(part: Path) -> None:
    part.unlink(missing_ok=True)
    part.with_name(part.name + ".json").unlink(missing_ok=True)


def _read_json(path: Path) -> dict[str, Any]:
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return data if isinstance(data, dict) else {}


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
