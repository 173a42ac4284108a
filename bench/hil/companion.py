"""Who is at the other end of the two ports: a command that we start, or whoever connects."""

import functools
import os
import signal
import subprocess
from pathlib import Path
from typing import Protocol

from saranga.errors import DeviceError, UsageError
from sitl.process import die_with_parent

STOP_DEADLINE_S = 5.0


class Companion(Protocol):
    """The other end."""

    def check(self) -> None:
        """Raises DeviceError when it has ended."""
        ...

    def last_line(self) -> str:
        """What it said last, "" when that cannot be known."""
        ...

    def close(self) -> None: ...


class RemoteCompanion:
    """Somebody connects: all that is known of it is its connections."""

    def check(self) -> None:
        """Nothing: a lost connection is seen at the ports."""

    def last_line(self) -> str:
        return ""

    def close(self) -> None:
        """Nothing to end."""


class CommandCompanion:
    """A command as a subprocess that dies with us.

    `{echoes}`, `{vehicle}` and `{speed}` in its words become the URLs and the course's speed in m/s, which are in
    SARANGA_ECHOES, SARANGA_VEHICLE and SARANGA_SPEED_M_S as well.

    Raises:
        UsageError: it cannot be started.
    """

    def __init__(self, command: tuple[str, ...], echoes: str, vehicle: str, speed_m_s: float,
                 folder: Path) -> None:
        self.console = folder / "companion.txt"
        told = {"echoes": echoes, "vehicle": vehicle, "speed": f"{speed_m_s:g}"}
        words = [functools.reduce(lambda w, k: w.replace(f"{{{k}}}", told[k]), told, word) for word in command]
        environment = {**os.environ, "SARANGA_ECHOES": echoes, "SARANGA_VEHICLE": vehicle,
                       "SARANGA_SPEED_M_S": told["speed"]}
        try:
            with self.console.open("wb") as console:
                self._process = subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=console,
                                                 stderr=subprocess.STDOUT, preexec_fn=die_with_parent,
                                                 start_new_session=True, env=environment)
        except OSError as error:
            raise UsageError(f"companion {words[0]!r} cannot be started: {error.strerror}; check the command after "
                             "--") from error

    def check(self) -> None:
        code = self._process.poll()
        if code is not None:
            raise DeviceError(f"companion ended (exit code {code}): {self.last_line() or 'it said nothing'}; all it "
                              f"said is in {self.console}")

    def last_line(self) -> str:
        lines = self.console.read_text(errors="replace").strip().splitlines()
        return lines[-1] if lines else ""

    def close(self) -> None:
        """SIGINT, then SIGKILL to all that it started."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
            try:
                self._process.wait(STOP_DEADLINE_S)
            except subprocess.TimeoutExpired:
                os.killpg(self._process.pid, signal.SIGKILL)
                self._process.wait()
