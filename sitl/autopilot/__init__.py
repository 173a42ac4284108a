"""Autopilots over the project's own physics: the real ArduCopter in lockstep, and the embedded one."""

from pathlib import Path

from saranga.errors import UsageError
from sitl.autopilot.base import Autopilot
from sitl.autopilot.parameters import Parameter

KINDS = ("embedded", "arducopter")


def make_autopilot(kind: str, seed: int, workdir: Path | None = None) -> tuple[Autopilot, list[Parameter]]:
    """An autopilot by name, not yet started, and the parameters to read back from it after its start.

    Raises:
        UsageError: a kind that does not exist.
        DeviceError: "arducopter" without its binary.
    """
    if kind == "embedded":
        from sitl.autopilot.embedded import EmbeddedAutopilot

        return EmbeddedAutopilot(seed=seed), []
    if kind == "arducopter":
        from sitl.autopilot.arducopter import ArduCopter
        from sitl.autopilot.binary import require_binary

        require_binary()
        autopilot = ArduCopter(workdir)
        return autopilot, autopilot.parameters
    raise UsageError(f"unknown autopilot {kind!r}: known are {', '.join(KINDS)}")
