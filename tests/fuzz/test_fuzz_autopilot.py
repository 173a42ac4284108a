"""The embedded autopilot against any bytes: no crash, no motor that turns, nothing but an order to arm arms."""

import copy
import copyreg
import struct

import pytest
from embedded_bench import Bench
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from mavlink_strategies import is_arm_order, stream

from sitl.autopilot.frames import FrameReader

# So that a vehicle in a certain state can be copied for every example: pymavlink keeps a Struct in each end.
copyreg.pickle(struct.Struct, lambda packed: (struct.Struct, (packed.format,)))
ANY = st.one_of(st.sampled_from([1, 255]), st.integers(0, 255))


def orders(data: bytes) -> list[object]:
    """The messages that the autopilot will understand in `data`."""
    reader = FrameReader()
    return [message for frame in reader.feed(data) if (message := reader.decode(frame)) is not None]


@pytest.fixture(scope="module")
def states() -> dict[str, Bench]:
    """Just booted; ready to arm, where only the order is missing; and flying in GUIDED."""
    booted, ready, flying = Bench(), Bench(), Bench()
    ready.make_ready()
    flying.take_off()
    assert flying.vehicle.armed and not ready.vehicle.armed
    return {"booted": booted, "ready": ready, "flying": flying}


@pytest.mark.parametrize("state", ["booted", "ready"])
@given(data=stream(ANY))
@settings(max_examples=120, deadline=None)
def test_nothing_but_an_order_to_arm_turns_a_motor(states: dict[str, Bench], state: str, data: bytes) -> None:
    assume(not any(is_arm_order(message) for message in orders(data)))
    bench = copy.deepcopy(states[state])
    bench.throttles.clear()
    bench.run(0.15, extra=data)
    assert not bench.vehicle.armed
    assert not any(any(throttle) for throttle in bench.throttles), "a motor turned"


@given(data=stream(ANY))
@settings(max_examples=60, deadline=None)
def test_a_vehicle_in_flight_survives_anything(states: dict[str, Bench], data: bytes) -> None:
    bench = copy.deepcopy(states["flying"])
    bench.run(0.3, extra=data)
    assert bench.autopilot.health() is None


def test_the_order_to_arm_does_arm(states: dict[str, Bench]) -> None:
    """What the tests above leave out is what they must leave out, and no more."""
    bench = copy.deepcopy(states["ready"])
    assert bench.arm() == 0 and bench.vehicle.armed
