"""Collecting a flight at the stack's tick, from take-off on, into a `FlightLog`."""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from saranga.echo import RANGE_COLUMNS
from saranga.stack import Decision
from sitl.ground_control import Phase
from sitl.scene import Scene
from sitl.trial_types import FlightLog

if TYPE_CHECKING:
    from sitl.world import World

# 0 is 60 dB under full scale, 255 is full scale.
FLOOR_DB = -60.0


def db_scaled(envelope: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Envelope in units of full scale as u8, linear in dB from -60 dB (0) to 0 dB (255)."""
    level_db = 20.0 * np.log10(np.maximum(envelope, 1e-6))
    return np.clip((level_db - FLOOR_DB) * (255.0 / -FLOOR_DB), 0, 255).astype(np.uint8)


class FlightRecorder:
    """Rows of one flight; `add` at each stack tick, `finish` once unless `empty`."""

    def __init__(self, scene: Scene, volume: Any) -> None:
        self._scene = scene
        self._volume = volume
        self._rows: list[tuple[Any, ...]] = []

    @property
    def empty(self) -> bool:
        """True while the vehicle has not taken off: there is nothing to draw."""
        return not self._rows

    def add(self, world: "World", decision: Decision) -> None:
        if world.phase in (Phase.START, Phase.READY):
            return
        state = world.physics.state
        command = decision.command
        empty = np.zeros(RANGE_COLUMNS, np.float32)
        newest = {role: image[-1].copy() for role, image in decision.images.items()}
        self._rows.append((
            state.t_us, state.pos_m.copy(), state.vel_m_s.copy(), state.quat.copy(), state.thrust_n.copy(),
            world.phase.value, (command.vx_m_s, command.vy_m_s, command.vz_m_s, command.yaw_rate_rad_s),
            newest.get("left", empty), newest.get("right", empty),
            decision.edges.get("left", empty), decision.edges.get("right", empty), decision.obstacles))

    def finish(self, events: list[tuple[int, str]]) -> FlightLog:
        columns: list[list[Any]] = [list(c) for c in zip(*self._rows, strict=True)]

        def array(index: int, width: int) -> NDArray[np.float64]:
            return np.array(columns[index], float).reshape(-1, width)

        def pixels(index: int, scale: bool) -> NDArray[np.uint8]:
            rows = np.array(columns[index], np.float32).reshape(-1, RANGE_COLUMNS)
            return db_scaled(rows) if scale else np.clip(np.nan_to_num(rows) * 255, 0, 255).astype(np.uint8)

        return FlightLog(
            t_us=np.array(columns[0], np.int64), pos_m=array(1, 3), vel_m_s=array(2, 3), quat=array(3, 4),
            thrust_n=array(4, 4), phase=list(columns[5]), command=array(6, 4),
            envelope_left=pixels(7, True), envelope_right=pixels(8, True),
            edges_left=pixels(9, False), edges_right=pixels(10, False), obstacles=list(columns[11]),
            airframe=vars(self._volume).copy(), scene=self._scene.to_dict(), events=list(events))
