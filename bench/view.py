"""Looking at recordings: the Rerun viewer on loopback only, and a picture of a recording without a display.

The viewer's own binary is started (the console script leaves an orphan), in a process group of its own that is
ended as a whole, with its settings in a temporary folder: the user's are not touched, and analytics are off.
"""

import contextlib
import importlib.util
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self
from urllib.parse import quote

from bench.blueprint import TIMELINE
from saranga.errors import DeviceError, UsageError
from sitl.process import die_with_parent
from sitl.trial_types import FlightLog, TrialResult

if TYPE_CHECKING:
    from rerun.experimental import ViewerClient

LOOPBACK = "127.0.0.1"
PICTURE_SIZE = (1600, 900)
START_LIMIT_S = 30.0
PICTURE_LIMIT_S = 90.0
# The first pictures of a fresh viewer are empty or half-drawn, two equal ones included.
PICTURE_SETTLE_S = 8.0
VULKAN_HINT = "install a software renderer: apt-get install mesa-vulkan-drivers"
# What the viewer dies with where Vulkan is missing: without any driver, and with an OpenGL one alone.
_NO_GRAPHICS = ("No graphics adapter", "Failed to get render context")


class Viewer:
    """A running viewer and its process group; `close` (or leaving the `with` block) ends both.

    Raises:
        DeviceError: it cannot be started, or died at once; the message says why and what to do.
    """

    def __init__(self, recordings: Sequence[Path], *, headless: bool = False, web: bool = False,
                 size: tuple[int, int] = PICTURE_SIZE) -> None:
        self._home = Path(tempfile.mkdtemp(prefix="saranga-view-"))
        self._log = self._home / "viewer.log"
        self.port = _free_port()
        self.web_port = _free_port() if web else None
        command = [str(viewer_binary()), "--bind", LOOPBACK, "--port", str(self.port), "--hide-welcome-screen"]
        if headless:
            command += ["--headless", "--window-size", f"{size[0]}x{size[1]}"]
        if web:
            command += ["--serve-web", "--web-viewer-port", str(self.web_port)]
        try:
            with self._log.open("wb") as log:
                self.process = subprocess.Popen(
                    [*command, *(str(p.resolve()) for p in recordings)], env=_environment(self._home),
                    stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT, start_new_session=True,
                    preexec_fn=die_with_parent)
        except OSError as error:
            shutil.rmtree(self._home, ignore_errors=True)
            raise DeviceError(f"the Rerun viewer cannot be started: {error}; reinstall rerun-sdk") from error
        try:
            self._wait_listening()
        except BaseException:
            self.close()
            raise

    @property
    def pid(self) -> int:
        """Process id, which is also the process group's."""
        return self.process.pid

    @property
    def url(self) -> str:
        """Where its data port listens; with `web`, the page to open in a browser."""
        data = f"rerun+http://{LOOPBACK}:{self.port}/proxy"
        return f"http://{LOOPBACK}:{self.web_port}/?url={quote(data, safe='')}" if self.web_port else data

    def wait(self) -> int:
        """Block until the user closes the window."""
        return self.process.wait()

    def log_text(self) -> str:
        """What the viewer wrote so far."""
        return self._log.read_text(encoding="utf-8", errors="replace") if self._log.exists() else ""

    def check_alive(self) -> None:
        """Raise DeviceError, with the reason, when it has exited."""
        if self.process.poll() is not None:
            raise DeviceError(_why(self.log_text(), self.process.returncode))

    def close(self) -> None:
        """End the whole process group and remove the temporary settings. May be called twice."""
        for number in (signal.SIGTERM, signal.SIGKILL):
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(self.process.pid, number)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.process.wait(timeout=3.0)
                break
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self.process.pid, signal.SIGKILL)
        shutil.rmtree(self._home, ignore_errors=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self.close()

    def _wait_listening(self) -> None:
        deadline = time.monotonic() + START_LIMIT_S
        while time.monotonic() < deadline:
            self.check_alive()
            try:
                socket.create_connection((LOOPBACK, self.web_port or self.port), timeout=1.0).close()
                return
            except OSError:
                time.sleep(0.1)
        raise DeviceError(f"the Rerun viewer did not listen within {START_LIMIT_S:g} s: {_tail(self.log_text())}")


def open_run(path: Path, *, web: bool = False) -> int:
    """Show a run's recordings until the window is closed or Ctrl-C; returns the viewer's exit code.

    Args:
        path: a .rrd file, or a run folder with some.
        web: serve it to a browser on this machine instead of opening a window; the address is printed.

    Raises:
        UsageError: nothing to show there.
        DeviceError: no display, or the viewer does not start.
    """
    recordings = recordings_of(path)
    no_display = sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    if no_display and not web:
        raise DeviceError(f"no display to open {path} on: open its report.html, or copy {recordings[0].name} to a "
                          "machine with a screen and run `saranga-bench view` there")
    with Viewer(recordings, web=web) as viewer:
        if web:
            print(f"open {viewer.url} in a browser on this machine; Ctrl-C ends it")
        return viewer.wait()


def recordings_of(path: Path) -> list[Path]:
    """The .rrd files at `path`, sorted.

    Raises:
        UsageError: there is none.
    """
    if path.is_file():
        return [path]
    found = sorted(path.glob("**/*.rrd")) if path.is_dir() else []
    if not found:
        raise UsageError(f"{path}: no .rrd recording there: give a run folder or a recording; `saranga-bench runs` "
                         "lists the runs")
    return found


def screenshot(rrd: Path, png: Path, time_s: float | None = None, size: tuple[int, int] = PICTURE_SIZE) -> Path:
    """Draw a recording without a display, laid out by its own blueprint.

    Args:
        rrd: the recording.
        png: where the picture goes.
        time_s: the moment on the timeline `sim_time`; None is 55 % of the recording.
        size: pixels.

    Raises:
        UsageError: no such recording.
        DeviceError: this machine cannot draw (no Vulkan driver), or the viewer failed.
    """
    if not rrd.is_file():
        raise UsageError(f"recording {rrd} does not exist")
    with Viewer([rrd], headless=True, size=size) as viewer:
        picture = _settled_picture(viewer, time_s)
    png.parent.mkdir(parents=True, exist_ok=True)
    png.write_bytes(picture)
    return png


def flight_picture(log: FlightLog, result: TrialResult, png: Path) -> tuple[Path, str]:
    """The best picture this machine can make of a flight: its recording at the most telling moment, or else the
    flight from above.

    Returns:
        The file, and what was drawn in words, with the reason where it is only the view from above.
    """
    from bench.drawing import Flight
    from bench.plots import plot_top_view
    from bench.rerun_log import record_flight

    with tempfile.TemporaryDirectory(prefix="saranga-picture-") as folder:
        rrd = record_flight(log, result, Path(folder) / "flight.rrd")
        moment_s = Flight(log, result).telling_time_s()
        try:
            return screenshot(rrd, png, moment_s), f"the recording at {moment_s:.1f} s"
        except DeviceError as error:
            return plot_top_view(log, result, png), f"the flight from above only: {error}"


def _settled_picture(viewer: Viewer, time_s: float | None) -> bytes:
    deadline = time.monotonic() + PICTURE_LIMIT_S
    client = _connect(viewer, deadline)
    moment_set, ready_at, last = False, 0.0, b""
    while time.monotonic() < deadline:
        viewer.check_alive()
        try:
            if not moment_set:
                state = client.get_state()
                if state.active_recording is None or state.loading:
                    time.sleep(0.2)
                    continue
                line = next(t for t in state.recordings[0].timelines if t.name == TIMELINE)
                first_s, last_s = float(line.start or 0) * 1e-9, float(line.end or 0) * 1e-9
                moment_s = first_s + 0.55 * (last_s - first_s) if time_s is None else time_s
                client.set_time(TIMELINE, duration=moment_s, play_state="paused")
                moment_set, ready_at = True, time.monotonic()
            picture = client.take_screenshot()
        except (RuntimeError, ConnectionError, StopIteration) as error:
            viewer.check_alive()
            if time.monotonic() > deadline - 1.0:
                raise DeviceError(f"the Rerun viewer does not answer: {error}") from error
            time.sleep(0.3)
            continue
        if picture == last and time.monotonic() - ready_at > PICTURE_SETTLE_S:
            return picture
        last = picture
        time.sleep(0.4)
    raise DeviceError(f"the Rerun viewer drew no settled picture within {PICTURE_LIMIT_S:g} s: is the machine busy?")


def _connect(viewer: Viewer, deadline: float) -> "ViewerClient":
    from rerun.experimental import ViewerClient

    while True:
        viewer.check_alive()
        try:
            return ViewerClient.connect(viewer.url)
        except (RuntimeError, ConnectionError) as error:
            if time.monotonic() > deadline:
                raise DeviceError(f"the Rerun viewer does not answer: {error}") from error
            time.sleep(0.2)


def viewer_binary() -> Path:
    """The viewer's own executable inside the rerun-sdk package.

    Raises:
        DeviceError: not installed.
    """
    found = importlib.util.find_spec("rerun_cli")
    if found is not None and found.origin is not None:
        binary = Path(found.origin).parent / ("rerun.exe" if sys.platform == "win32" else "rerun")
        if binary.is_file():
            return binary
    raise DeviceError("the Rerun viewer is not installed here: pip install rerun-sdk==0.41.0")


def _environment(home: Path) -> dict[str, str]:
    """This environment, with settings in `home` that say no to analytics."""
    for folder in (home / "config" / "rerun", home / "Library" / "Application Support" / "rerun"):
        folder.mkdir(parents=True)
        file = folder / "analytics.json"
        file.write_text(json.dumps({"analytics_enabled": False, "analytics_id": "off", "metadata": {},
                                    "config_file_path": str(file), "data_dir_path": str(home / "data")}),
                        encoding="utf-8")
    environment = dict(os.environ, XDG_CONFIG_HOME=str(home / "config"), XDG_DATA_HOME=str(home / "data"),
                       XDG_CACHE_HOME=str(home / "cache"), RUST_LOG="warn", NO_COLOR="1")
    if sys.platform == "darwin":
        environment["HOME"] = str(home)
    return environment


def _why(log: str, code: int | None) -> str:
    if any(sign in log for sign in _NO_GRAPHICS):
        return f"this machine has no graphics driver the Rerun viewer can draw with (Vulkan): {VULKAN_HINT}"
    panic = re.search(r"panicked at '(.*?)'$", log, re.MULTILINE)
    return f"the Rerun viewer exited with code {code}: {panic.group(1) if panic else _tail(log)}"


def _tail(log: str) -> str:
    lines = [line.strip() for line in log.splitlines() if line.strip()]
    return " / ".join(lines[-3:]) or "it said nothing"


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        return int(probe.getsockname()[1])
