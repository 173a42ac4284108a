"""A rehearsal: `emulated:` in place of a device starts one on this computer, as a process that ends with us.

Who knows the device says what to start (`bench.rig.rehearsal`, `bench.preflight.emulated`); here it starts and ends.
"""

import json
import select
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any
from urllib.parse import parse_qsl

from saranga.errors import DeviceError, UsageError
from sitl.process import die_with_parent

SCHEME = "emulated:"
START_S = 180.0


def is_emulated(url: str | None) -> bool:
    """Whether a URL asks for one to be started."""
    return url is not None and url.startswith(SCHEME)


@dataclass(frozen=True)
class Ordered:
    """What to start."""

    command: tuple[str, ...]
    what: str


def split_url(url: str, known: tuple[str, ...]) -> tuple[str, list[tuple[str, str]]]:
    """What stands before "?", and the options in order.

    Raises:
        UsageError: an option that is not of the `known`.
    """
    kind, _, query = url.removeprefix(SCHEME).partition("?")
    options = parse_qsl(query, keep_blank_values=True)
    for key, _ in options:
        if key not in known:
            raise UsageError(f"{url!r}: no option {key!r}: known are {', '.join(known)}")
    return kind.strip("/"), options


class Started:
    """A process that serves a URL; `url` waits for it."""

    def __init__(self, ordered: Ordered) -> None:
        self._what = ordered.what
        self._process = subprocess.Popen(ordered.command, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                                         stderr=subprocess.PIPE, preexec_fn=die_with_parent, start_new_session=True)

    def url(self, stop: Callable[[], bool] = lambda: False, seconds: float = START_S) -> str | None:
        """Its URL, once it serves; None where `stop` came first.

        Raises:
            DeviceError: it ended, or did not get ready in time.
        """
        out, deadline = self._process.stdout, time.monotonic() + seconds
        assert out is not None
        while time.monotonic() < deadline:
            if stop():
                return None
            if not select.select([out], [], [], 0.2)[0]:
                continue
            line = out.readline()
            if line:
                told: dict[str, Any] = json.loads(line)
                return str(told["url"])
            error = self._process.stderr.read().decode(errors="replace").strip() if self._process.stderr else ""
            raise DeviceError(f"{self._what} did not start: {error.removeprefix('error: ') or 'no reason given'}")
        raise DeviceError(f"{self._what} was not ready within {seconds:g} s: is this computer busy?")

    def close(self) -> None:
        """End it. The end of its standard input is the sign; what does not heed it is killed."""
        for stream in (self._process.stdin, self._process.stdout, self._process.stderr):
            if stream is not None:
                stream.close()
        self._process.terminate()
        try:
            self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
