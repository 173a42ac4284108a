"""What the kill matrix needs around a run: an emulated device as a process, and a probe of how busy the machine is."""

import contextlib
import os
import select
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import TracebackType

from saranga.errors import DeviceError
from sitl.process import die_with_parent

START_TIMEOUT_S = 240.0
"""The first start after a change of the sources compiles."""
PROBE_SLEEP_S = 0.002


def go_first(pid: int) -> bool:
    """Real-time scheduling for a process whose times are measured; whether that was allowed."""
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(pid, os.SCHED_RR, os.sched_param(1))
        return True
    return False


class EmulatedProcess:
    """`saranga-bench rig emulate` on a TCP port of the loopback; `truth` is the device's own log."""

    def __init__(self, folder: Path, name: str, stand: str | None) -> None:
        self.truth = folder / f"{name}.truth.jsonl"
        command = [sys.executable, "-m", "bench.cli", "rig", "emulate", "--port", "tcp", "--truth", str(self.truth)]
        with (folder / f"{name}.err").open("wb") as errors:
            self._process = subprocess.Popen(command + (["--stand", stand] if stand else []), stdin=subprocess.PIPE,
                                             stdout=subprocess.PIPE, stderr=errors, start_new_session=True,
                                             preexec_fn=die_with_parent)
        assert self._process.stdout is not None
        ready, _, _ = select.select([self._process.stdout], [], [], START_TIMEOUT_S)
        line = self._process.stdout.readline().decode().strip() if ready else ""
        if not line.startswith("tcp://"):
            self.close()
            raise DeviceError(f"the emulated device did not come up: {(folder / f'{name}.err').read_text()[-500:]}")
        self.rig_url = line
        go_first(self._process.pid)  # a real device does not wait for this computer either

    @property
    def stand_url(self) -> str:
        """As a thrust stand."""
        return f"teensy+{self.rig_url}"

    @property
    def alive(self) -> bool:
        """Whether it runs."""
        return self._process.poll() is None

    def order(self, text: str) -> None:
        """"unplug" or "plug". Raises DeviceError when it is gone."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(text.encode() + b"\n")
            self._process.stdin.flush()
        except OSError as error:
            raise DeviceError(f"the emulated device is gone: {error}") from error

    def close(self) -> None:
        """Switch it off. May be called twice."""
        if self._process.poll() is None:
            self._process.terminate()
        try:
            self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):
                    pipe.close()


class Bay:
    """An emulated device, used by one cell after the other; a second one where a rig with its own port is wanted."""

    def __init__(self, folder: Path, stand: str) -> None:
        self._folder = folder
        self._stand = stand
        folder.mkdir(parents=True)
        self.device = EmulatedProcess(folder, "device", stand)
        self._rig: EmulatedProcess | None = None

    def own_rig(self) -> EmulatedProcess:
        """Started when first wanted; anew when the thread that started it has ended, which ends it too."""
        if self._rig is None or not self._rig.alive:
            if self._rig is not None:
                self._rig.close()
            self._rig = EmulatedProcess(self._folder, "rig", None)
        return self._rig

    def close(self) -> None:
        """Switch all off."""
        self.device.close()
        if self._rig is not None:
            self._rig.close()


class StarvationProbe:
    """Sleeps 2 ms again and again and keeps how much too late it woke up: what the machine did to everybody."""

    def __init__(self) -> None:
        self._over = threading.Event()
        self._late: list[tuple[float, float]] = []
        self._thread = threading.Thread(target=self._run, name="starvation probe", daemon=True)

    def worst_ms(self, begin_s: float, end_s: float) -> float:
        """Longest lateness in that time."""
        return max((late * 1e3 for at, late in list(self._late) if begin_s <= at <= end_s), default=0.0)

    def __enter__(self) -> "StarvationProbe":
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
                 ) -> None:
        self._over.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._over.is_set():
            began_s = time.monotonic()
            time.sleep(PROBE_SLEEP_S)
            now_s = time.monotonic()
            self._late.append((now_s, now_s - began_s - PROBE_SLEEP_S))
