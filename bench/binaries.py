"""The real autopilot's binary: where it is, what it is, without importing the simulator."""

import os
import re
import subprocess
from dataclasses import dataclass
from pathlib import Path

from saranga.errors import DeviceError
from sitl.autopilot.binary import WHAT_TO_DO

CHECK_TIMEOUT_S = 15.0
MACHINES = {0x3E: "x86_64", 0xB7: "aarch64", 0x28: "arm", 0x03: "i386"}
FIRMWARE = re.compile(
    rb"\b(ArduCopter|ArduPlane|ArduRover|Rover|ArduSub|Blimp|AntennaTracker|APM:Copter) "
    rb"(V\d+\.\d+[.\d]*[-\w]*)"
)
@dataclass(frozen=True)
class Firmware:
    """What a binary says it is."""

    path: Path
    vehicle: str
    version: str
    machine: str


def inspect_binary(path: Path) -> Firmware:
    """Read a SITL binary's headers and the version text compiled into it; nothing is started.

    Raises:
        DeviceError: not a Linux executable, for another machine, or not ArduCopter.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise DeviceError(f"{path}: cannot be read: {error.strerror}; {WHAT_TO_DO}") from error
    if data[:4] != b"\x7fELF" or len(data) < 64:
        raise DeviceError(
            f"{path} is not a Linux executable ({len(data)} bytes, starts with {data[:4]!r}): {WHAT_TO_DO}"
        )
    code = int.from_bytes(data[18:20], "little")
    machine, ours = MACHINES.get(code, f"machine {code:#x}"), os.uname().machine
    if machine != ours:
        raise DeviceError(f"{path} is built for {machine} and this machine is {ours}: build it here from source")
    found = FIRMWARE.search(data)
    if found is None:
        raise DeviceError(f"{path} carries no ArduPilot version text: is it ArduCopter's SITL build? {WHAT_TO_DO}")
    vehicle, version = found[1].decode(), found[2].decode()
    if vehicle not in ("ArduCopter", "APM:Copter"):
        raise DeviceError(f"{path} is {vehicle} {version}, wrong firmware: ArduCopter is needed; {WHAT_TO_DO}")
    return Firmware(path, vehicle, version, machine)


def check_starts(path: Path) -> None:
    """Start it for its help text.

    Raises:
        DeviceError: it cannot be started, hangs, or dies; with its own last words.
    """
    try:
        done = subprocess.run(
            [str(path.resolve()), "--help"],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=CHECK_TIMEOUT_S,
            cwd="/",
        )
    except subprocess.TimeoutExpired:
        raise DeviceError(f"{path} --help did not end within {CHECK_TIMEOUT_S:g} s: is it a SITL build?") from None
    except OSError as error:
        raise DeviceError(f"{path}: cannot be started: {error.strerror}; {WHAT_TO_DO}") from error
    said = (done.stdout + done.stderr).decode(errors="replace")
    if done.returncode < 0 or "--model" not in said:
        last = said.strip().splitlines()[-1:] or ["nothing"]
        raise DeviceError(f"{path} --help ended with {done.returncode} and said {last[0]!r}: {WHAT_TO_DO}")
