"""MAVSDK on the one link there is: a loopback UDP port beside it, everything it sends held to `guard.py`."""

import json
import select
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bench.preflight.guard import GuardedLink
from sitl.process import die_with_parent

LOOPBACK = "127.0.0.1"
DATAGRAM = 280
"""A frame of MAVLink 2 at its longest; datagrams hold whole frames or pieces alike, MAVSDK joins them."""


def ask_mavsdk(link: GuardedLink, seconds: float, log: Path | None = None,
               stop: Callable[[], bool] = lambda: False) -> dict[str, Any]:
    """Let MAVSDK read the vehicle for at most `seconds`; its values with `heard_s`, or `failed` with the reason.

    Raises:
        DeviceError: the vehicle's link was lost meanwhile.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ours:
        ours.bind((LOOPBACK, 0))
        ours.setblocking(False)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind((LOOPBACK, 0))
            theirs = probe.getsockname()
        command = [sys.executable, "-m", "bench.preflight.mavsdk_reader", f"udpin://{LOOPBACK}:{theirs[1]}"]
        command += ["--log", str(log)] if log is not None else []
        try:
            process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                                       stderr=subprocess.DEVNULL, preexec_fn=die_with_parent)
        except OSError as error:
            return {"failed": f"MAVSDK's process cannot be started: {error.strerror}"}
        try:
            late = _forward(link, ours, theirs, process, time.monotonic() + seconds, stop)
            return _answer(process, late)
        finally:
            process.kill()
            process.wait()
            if process.stdout is not None:
                process.stdout.close()


def _forward(link: GuardedLink, ours: socket.socket, theirs: tuple[str, int], process: subprocess.Popen[bytes],
             deadline: float, stop: Callable[[], bool]) -> str:
    """Both ways until the process ends; why it was cut off, "" where it was not."""
    while process.poll() is None:
        if stop():
            return "interrupted by the operator"
        if time.monotonic() > deadline:
            return "MAVSDK was not done in time"
        data = link.read(0.02)
        for start in range(0, len(data), DATAGRAM):
            try:
                ours.sendto(data[start:start + DATAGRAM], theirs)
            except OSError:
                break  # it does not listen yet
        while select.select([ours], [], [], 0.0)[0]:
            try:
                link.write(ours.recv(65_536))
            except ConnectionRefusedError:
                break
    return ""


def _answer(process: subprocess.Popen[bytes], late: str) -> dict[str, Any]:
    if late:
        return {"failed": late}
    assert process.stdout is not None
    text = process.stdout.read().decode("utf-8", "replace").strip()
    try:
        seen = json.loads(text.splitlines()[-1])
    except (ValueError, IndexError):
        return {"failed": f"MAVSDK's process ended with code {process.returncode} and no answer"}
    return {**seen, "heard_s": time.monotonic()}
