"""What can cut a run off, each done for real."""

import os
import signal
from collections.abc import Callable
from dataclasses import dataclass

from bench.supervisor.emulated import EmulatedProcess

PHASES = ("idle", "ramp", "hold", "ramp-down")
SPINNING = PHASES[1:]


@dataclass(frozen=True)
class Stage:
    """What a cause acts on: process ids, and the devices."""

    control_pid: int
    supervisor_pid: int
    stand: EmulatedProcess
    rig: EmulatedProcess | None


@dataclass(frozen=True)
class Cause:
    """One row of the matrix.

    Args:
        name: for people.
        fire: does it.
        mend: undoes what a resumed run could not live with.
        own_rig: the rig is a device of its own (else it shares the stand's port).
        under_pytest: the control process is a pytest with a time-out.
        latches: phases in which a trip is left that the operator has to clear before the run can be resumed.
        survived_in: phases in which the run rightly goes on by itself once the cause has passed.
    """

    name: str
    fire: Callable[[Stage], None]
    mend: Callable[[Stage], None] = lambda stage: None
    own_rig: bool = False
    under_pytest: bool = False
    latches: tuple[str, ...] = ()
    survived_in: tuple[str, ...] = ()


def _send(number: signal.Signals) -> Callable[[Stage], None]:
    return lambda stage: os.kill(stage.control_pid, number)


def _send_to_group(number: signal.Signals) -> Callable[[Stage], None]:
    """As a terminal does: to every process of the foreground group."""
    return lambda stage: os.killpg(stage.control_pid, number)


def _unplug_rig(stage: Stage) -> None:
    assert stage.rig is not None
    stage.rig.order("unplug")


def _plug_rig(stage: Stage) -> None:
    assert stage.rig is not None
    stage.rig.order("plug")


CAUSES = {cause.name: cause for cause in (
    Cause("SIGINT", _send_to_group(signal.SIGINT)),
    Cause("SIGTERM", _send(signal.SIGTERM)),
    Cause("SIGHUP", _send_to_group(signal.SIGHUP)),
    Cause("SIGKILL", _send(signal.SIGKILL)),
    # pytest-timeout's own alarm, sent early: a time-out that falls into the phase that is wanted.
    Cause("test timeout", _send(signal.SIGALRM), under_pytest=True),
    # Stopped, it does nothing at all: as hung as a loop can be. At idle that is allowed, and it goes on afterwards.
    Cause("hung loop", _send(signal.SIGSTOP), _send(signal.SIGCONT), latches=SPINNING,
          survived_in=("idle",)),
    Cause("rig unplugged", _unplug_rig, _plug_rig, own_rig=True),
    Cause("stand unplugged", lambda stage: stage.stand.order("unplug"), lambda stage: stage.stand.order("plug"),
          latches=PHASES),
    Cause("supervisor killed", lambda stage: os.kill(stage.supervisor_pid, signal.SIGKILL)),
)}
