"""`emulated:` instead of a device: an emulated rig and stand in a process of its own, started and ended by the sweep.

    emulated:[?propeller=d3&sonar=pair&seed=1&mounting_sd_db=0.3&shield=NAME=dB&fault=NAME=VALUE]

`shield` and `fault` may come several times; what `saranga-bench rig emulate` makes of them is in docs/rig.md.
"""

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any
from urllib.parse import parse_qsl

from bench.emulated import SCHEME, is_emulated
from bench.procedures.plan import Condition, NoisePlan
from saranga.errors import DeviceError, UsageError
from saranga.plugins import nearest_hint
from sitl.process import die_with_parent

if TYPE_CHECKING:
    from bench.rig.emulator import EmulatedDevice

START_LIMIT_S = 120.0
"""The first start after an installation compiles."""
ORDER_LIMIT_S = 5.0
DEFAULT_PROPELLER = "d3"
DEFAULT_MOUNTING_SD_DB = 0.3
"""How much two mountings of one shield differ on the emulated bench; an assumption, of the size of a careful one."""
KEYS = ("propeller", "sonar", "seed", "mounting_sd_db", "shield", "fault")


@dataclass(frozen=True)
class EmulatedSpec:
    """What an `emulated:` URL asks for."""

    propeller: str = DEFAULT_PROPELLER
    sonar: str = "pair"
    seed: int = 1
    mounting_sd_db: float = DEFAULT_MOUNTING_SD_DB
    shields: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()

    def with_shields_of(self, plan: NoisePlan) -> "EmulatedSpec":
        """Also knowing every shield of a plan; the first stays the reference's, or nothing."""
        named = [t.partition("=")[0] for t in self.shields]
        more = [c.shield for c in plan.conditions if c.shield not in (*named, "none")]
        return replace(self, shields=("none=0", *self.shields, *dict.fromkeys(more)))


def parse_emulated(*urls: str | None) -> EmulatedSpec:
    """The options of one or two `emulated:` URLs (rig's and stand's) as one.

    Raises:
        UsageError: an unknown option, a value that is no number, or two different values of one.
    """
    values: dict[str, Any] = {}
    lists: dict[str, list[str]] = {"shield": [], "fault": []}
    for url in urls:
        if url is None or not is_emulated(url):
            continue
        rest = url.removeprefix(SCHEME).lstrip("/")
        if rest and not rest.startswith("?"):
            raise UsageError(f"{url!r}: after emulated: come options such as ?propeller={DEFAULT_PROPELLER}&seed=2")
        for key, text in parse_qsl(rest.removeprefix("?"), keep_blank_values=True):
            if key not in KEYS:
                raise UsageError(f"{url!r}: unknown option {key!r}{nearest_hint(key, list(KEYS))}: known are "
                                 f"{', '.join(KEYS)}")
            if key in lists:
                lists[key] += [text] if text not in lists[key] else []
                continue
            value = _value(url, key, text)
            if values.setdefault(key, value) != value:
                raise UsageError(f"{url!r}: {key} is {text} here and {values[key]} in the other URL: rig and stand are "
                                 "one device; give it once")
    return EmulatedSpec(**values, shields=tuple(lists["shield"]), faults=tuple(lists["fault"]))


def make_emulated(spec: EmulatedSpec, plan: NoisePlan, **more: Any) -> "EmulatedDevice":
    """The device in this process, for simulated time."""
    from bench.rig.emulate_command import make_device

    spec = spec.with_shields_of(plan)
    return make_device(spec.sonar, spec.propeller, list(spec.shields), spec.mounting_sd_db, "none", list(spec.faults),
                       spec.seed, **more)


class EmulatedProcess:
    """The device as its own process on a TCP port of the loopback. It dies with this process, however that ends."""

    def __init__(self, spec: EmulatedSpec, plan: NoisePlan, truth: Path | None = None) -> None:
        spec = spec.with_shields_of(plan)
        command = [sys.executable, "-m", "bench.cli", "rig", "emulate", "--port", "tcp", "--sonar", spec.sonar,
                   "--stand", spec.propeller, "--mounting-sd-db", str(spec.mounting_sd_db), "--reflector", "none",
                   "--seed", str(spec.seed), "--json"]
        for text in spec.shields:
            command += ["--shield", text]
        for text in spec.faults:
            command += ["--fault", text]
        if truth is not None:
            command += ["--truth", str(truth)]
        root = str(Path(__file__).resolve().parents[2])
        path = os.pathsep.join([root, *filter(None, [os.environ.get("PYTHONPATH")])])
        # A session of its own: Ctrl-C is for the sweep, which ramps down first.
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True,
            env={**os.environ, "PYTHONPATH": path},
            preexec_fn=partial(die_with_parent, signal.SIGTERM))
        self._pending: dict[int, bytes] = {}
        self.given: dict[str, Any] = {}
        try:
            assert self._process.stdout is not None
            said = json.loads(self._line(self._process.stdout, START_LIMIT_S))
            self.url, self.given = str(said["url"]), dict(said["given"])
        except (ValueError, KeyError) as error:
            self.close()
            raise DeviceError(f"the emulated device gave no URL: {error}") from error
        except BaseException:
            self.close()
            raise

    @property
    def pid(self) -> int:
        return self._process.pid

    def mount(self, condition: Condition) -> None:
        """Have it put a shield on. Raises DeviceError when it refuses or does not answer."""
        refuse_what_only_simulated_time_can(condition)
        assert self._process.stdin is not None and self._process.stderr is not None
        try:
            self._process.stdin.write(f"shield {condition.shield}\n".encode())
            self._process.stdin.flush()
        except OSError as error:
            raise DeviceError(f"the emulated device is gone: {error}") from error
        end_s = time.monotonic() + ORDER_LIMIT_S
        while True:
            line = self._line(self._process.stderr, end_s - time.monotonic())
            if line == f"done shield {condition.shield}":
                return
            if line.startswith("refused"):
                raise DeviceError(f"the emulated device: {line}")

    def close(self) -> None:
        """End it. May be called twice."""
        process = self._process
        if process.stdin is not None and not process.stdin.closed:
            with contextlib.suppress(OSError):
                process.stdin.write(b"quit\n")
                process.stdin.close()
        for number in (None, signal.SIGTERM, signal.SIGKILL):
            if number is not None:
                with contextlib.suppress(ProcessLookupError):
                    process.send_signal(number)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(timeout=3.0)
                break
        for stream in (process.stdout, process.stderr):
            if stream is not None:
                stream.close()

    def _line(self, stream: IO[bytes], timeout_s: float) -> str:
        """The next line, bytes left over are kept."""
        descriptor = stream.fileno()
        end_s = time.monotonic() + timeout_s
        data = self._pending.get(descriptor, b"")
        poll = select.poll()
        poll.register(descriptor, select.POLLIN)
        while b"\n" not in data:
            left_s = end_s - time.monotonic()
            if left_s <= 0.0:
                raise DeviceError(f"the emulated device said nothing for {timeout_s:.0f} s; is the machine overloaded?")
            if not poll.poll(max(1, left_s * 1e3)):
                continue
            piece = os.read(descriptor, 65_536)
            if not piece:
                raise DeviceError(f"the emulated device ended: {self._last_words()}")
            data += piece
        line, _, self._pending[descriptor] = data.partition(b"\n")
        return line.decode(errors="replace").strip()

    def _last_words(self) -> str:
        assert self._process.stderr is not None
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout=3.0)
        text = self._process.stderr.read().decode(errors="replace") if self._process.poll() is not None else ""
        return text.strip().removeprefix("error: ").splitlines()[-1] if text.strip() else "without a word"


def refuse_what_only_simulated_time_can(condition: Condition) -> None:
    """Raise UsageError for a condition that changes propeller or distance, which the emulated process cannot."""
    if condition.propeller or condition.hub_distance_m is not None:
        what = "its propeller" if condition.propeller else "the sensor's distance"
        raise UsageError(f"condition {condition.name!r} changes {what}: emulated hardware can do that only in "
                         "simulated time; add --simulated-time, or run on a real bench")


def _value(url: str, key: str, text: str) -> str | int | float:
    if key in ("propeller", "sonar"):
        return text
    kind = int if key == "seed" else float
    try:
        return kind(text)
    except ValueError:
        raise UsageError(f"{url!r}: {key} = {text!r} is not a number") from None
