"""How a flight that a planted fault broke off came down: the judge has spoken, the vehicle is still in the air."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from saranga.errors import DeviceError
from sitl.ground_control import Phase
from sitl.judge import Judge

if TYPE_CHECKING:
    from sitl.world import World

PATIENCE_US = 25_000_000
UPRIGHT_COS = 0.8
"""Of the tilt, on the ground: a vehicle that lies on its side has not landed."""


def aftermath(world: "World", outgoing: Callable[[int], bytes]) -> str | None:
    """Fly on until the vehicle is down or has touched something.

    Only where the autopilot ended the flight by itself (ground station in FAILED), so that its failsafe is seen to
    its end; None elsewhere.

    Returns:
        "landed after 4.2 s", "hit ...", or where the vehicle still was after 25 s.
    """
    if world.phase is not Phase.FAILED or world.physics.state.on_ground:
        return None
    begun_us = world.t_us
    judge = Judge(world.scene, world.volume)
    state = world.physics.state
    try:
        while world.t_us - begun_us < PATIENCE_US:
            tick = world.tick(outgoing(world.t_us))
            judge.update(tick.t_us, state.pos_m, state.quat)
            if judge.finished:
                return f"then {judge.result().cause}"
            if state.on_ground and not world.ground.link.status.armed:
                after_s = (tick.t_us - begun_us) / 1e6
                x, y = state.quat[1], state.quat[2]
                upright = 1.0 - 2.0 * float(x * x + y * y) >= UPRIGHT_COS
                return f"{'landed' if upright else 'came down on its side'} after {after_s:.1f} s"
    except DeviceError as error:
        return f"then {error}"
    return f"still {world.height_m:.2f} m up or armed after {PATIENCE_US / 1e6:g} s"
