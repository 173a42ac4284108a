"""Where the real autopilot's binary is. Light: imports no simulator."""

import os
from pathlib import Path

from saranga.errors import DeviceError

WHAT_TO_DO = (
    "run `saranga-bench sitl install`, or set ARDUCOPTER to the path of an ArduCopter SITL binary that you built "
    "from ArduPilot's source"
)


def cache_dir() -> Path:
    """Where installed binaries live: `~/.cache/saranga-bench`."""
    return Path.home() / ".cache" / "saranga-bench"


def arducopter_path() -> Path:
    """`$ARDUCOPTER`, else the installed one; it need not exist."""
    named = os.environ.get("ARDUCOPTER")
    return Path(named).expanduser() if named else cache_dir() / "arducopter"


def why_absent() -> str | None:
    """None when the binary can be started, else one line with what to do."""
    path = arducopter_path()
    if not path.is_file():
        return f"ArduCopter SITL binary not found at {path}: {WHAT_TO_DO}"
    if not os.access(path, os.X_OK):
        return f"{path} is not executable: run `chmod +x {path}`"
    return None


def require_binary() -> Path:
    """The binary's path.

    Raises:
        DeviceError: absent or not executable, with the way to get it.
    """
    absent = why_absent()
    if absent is not None:
        raise DeviceError(absent)
    return arducopter_path()
