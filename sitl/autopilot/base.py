"""What every autopilot offers the world: sensors of one physics tick in, motor outputs out, MAVLink bytes both ways."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, runtime_checkable

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from sitl.physics import VehicleState


@runtime_checkable
class Autopilot(Protocol):
    """A flight controller in lockstep with the physics.

    Attributes:
        kind: "embedded" or "arducopter".
        version: what it calls itself, for provenance.
        tick_us: the physics tick it wants, integer microseconds.
    """

    kind: str
    version: str
    tick_us: int

    def start(self, state: VehicleState) -> None:
        """Boot.

        Raises:
            DeviceError: it cannot be started; the message names what is missing and what to do.
        """
        ...

    def step(self, state: VehicleState, mavlink_in: bytes) -> tuple[NDArray[np.float64], bytes]:
        """One physics tick.

        Args:
            state: the world's truth at this tick, from which IMU and barometer are made.
            mavlink_in: bytes from ground station, companion and MAVLink sensors.

        Returns:
            throttle (4,) in 0..1 for the motors in ArduCopter's order, and MAVLink bytes out.

        Raises:
            DeviceError: it died or stopped answering; the message carries the cause.
        """
        ...

    def health(self) -> str | None:
        """None while alive, else why it is dead."""
        ...

    def close(self) -> None:
        """Stop it and leave nothing running; may be called twice."""
        ...
