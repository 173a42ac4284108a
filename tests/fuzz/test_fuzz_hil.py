"""What measures the companion, against a companion gone mad: figures that can be written, whatever it sends."""

import json
from types import SimpleNamespace

from hypothesis import given, settings
from hypothesis import strategies as st
from mavlink_strategies import frame, stream

from bench.hil.timing import WireTiming
from sitl.autopilot.frames import FrameReader
from sitl.live import Shadow


def whole(data: bytes) -> bytes:
    """As the port gives it: whole frames only."""
    return b"".join(f.raw for f in FrameReader().feed(data))


SETPOINT = st.binary(min_size=53, max_size=53).map(lambda payload: frame(84, payload, 1, 191))
TIMESYNC = st.binary(min_size=16, max_size=16).map(lambda payload: frame(111, payload, 1, 191))


@given(st.lists(st.one_of(stream(st.integers(0, 255)), SETPOINT, TIMESYNC), max_size=12))
@settings(max_examples=150, deadline=None)
def test_no_companion_can_break_the_figures(pieces: list[bytes]) -> None:
    timing = WireTiming()
    timing.begin(0.0)
    for k, piece in enumerate(pieces):
        timing.question(0.02 * k)
        timing.cycle(0.02 * k, True)
        timing.hear(whole(piece), 0.02 * k + 0.01)
    timing.end(1.0)
    json.dumps({"figures": timing.figures(), "rows": timing.rows()}, allow_nan=False)


@given(st.lists(st.one_of(stream(st.integers(0, 255)), SETPOINT), max_size=8))
@settings(max_examples=100, deadline=None)
def test_the_flight_log_never_gets_a_command_that_is_not_finite(pieces: list[bytes]) -> None:
    scene = SimpleNamespace(weather=SimpleNamespace(temperature_c=20.0))
    world = SimpleNamespace(geometry=SimpleNamespace(positions_m={"left": None}), scene=scene)
    shadow = Shadow(world)  # type: ignore[arg-type]
    for piece in pieces:
        shadow.saw_mavlink(whole(piece))
    json.dumps([getattr(shadow.decision(0).command, name) for name in ("vx_m_s", "vy_m_s", "vz_m_s", "yaw_rate_rad_s")],
               allow_nan=False)
