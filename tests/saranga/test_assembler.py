"""Cycles out of ECHO messages: dead, returning, late and repeated sensors, and the wrapping clock."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from saranga.wire import FLAG_BOOT, CycleAssembler, Echo, Hello, SensorInfo, Status

ROLES = ("left", "right", "down")


def hello(count=2, flags=0, order=(0, 1, 2)):
    return Hello(firmware="t", flags=flags, sensors=tuple(
        SensorInfo(sensor=n, role=ROLES[order[n]], fop_hz=53_000.0, bandwidth_hz=3980.0) for n in range(count)))


def echo(sensor, trigger, time_us=None):
    time_us = 25_600 * trigger if time_us is None else time_us
    return Echo(sensor=sensor, sequence=trigger, trigger=trigger, device_time_us=time_us % (1 << 32), fop_hz=53_000.0,
                odr=6, mode=0, iq=np.full((4, 2), trigger % 1000, np.int16))


def run(messages, assembler=None):
    assembler = assembler or CycleAssembler()
    return [c for m in messages if (c := assembler.add(m)) is not None], assembler


def shape(cycles):
    return [(c.trigger, "".join(sorted(role[0] for role in c.frames))) for c in cycles]


def test_cycle_is_complete_with_its_last_sensor():
    assembler = CycleAssembler()
    assert assembler.add(hello(3)) is None and assembler.add(Status()) is None
    assert assembler.add(echo(0, 5)) is None and assembler.add(echo(2, 5)) is None
    cycle = assembler.add(echo(1, 5))
    assert cycle is not None and cycle.trigger == 5 and cycle.t_us == 5 * 25_600
    assert {role: f.sensor for role, f in cycle.frames.items()} == {"left": 0, "right": 1, "down": 2}
    frame = cycle.frames["right"]
    assert (frame.role, frame.trigger, frame.odr, frame.device_time_us) == ("right", 5, 6, 5 * 25_600)
    assert frame.iq.shape == (4, 2) and frame.iq[0, 0] == 5


def test_roles_come_from_hello():
    cycles, _ = run([hello(2, order=(1, 0)), echo(0, 1), echo(1, 1)])
    assert cycles[0].frames["right"].sensor == 0 and cycles[0].frames["left"].sensor == 1


def test_before_hello_and_without_role_nothing_comes_but_counts():
    cycles, assembler = run([echo(0, 1), echo(1, 1), hello(2), echo(7, 2), echo(0, 2), echo(1, 2)])
    assert shape(cycles) == [(2, "lr")] and assembler.counters.unknown == 3


def test_single_sensor():
    cycles, _ = run([hello(1), echo(0, 1), echo(0, 2), echo(0, 4)])
    assert shape(cycles) == [(1, "l"), (2, "l"), (4, "l")]


def test_dead_sensor_delays_by_one_cycle_and_no_more():
    """Sensor 1 dies after trigger 1 and is back at 5: from its first frame on cycles are whole again."""
    assembler = CycleAssembler()
    assembler.add(hello(2))
    released = {}
    for trigger in range(8):
        for sensor in (0, 1):
            if sensor == 1 and 2 <= trigger <= 4:
                continue
            cycle = assembler.add(echo(sensor, trigger))
            if cycle is not None:
                released[cycle.trigger] = (trigger, "".join(sorted(r[0] for r in cycle.frames)))
    assert released == {0: (0, "lr"), 1: (1, "lr"), 2: (3, "l"), 3: (4, "l"), 4: (5, "l"), 5: (5, "lr"),
                        6: (6, "lr"), 7: (7, "lr")}
    assert assembler.counters.incomplete == 3 and assembler.counters.cycles == 8


def test_dead_first_sensor():
    cycles, _ = run([hello(2), *[echo(1, t) for t in range(4)]])
    assert shape(cycles) == [(0, "r"), (1, "r"), (2, "r")]


def test_order_within_a_cycle_does_not_matter():
    cycles, assembler = run([hello(2), echo(1, 1), echo(0, 1), echo(0, 2), echo(1, 2)])
    assert shape(cycles) == [(1, "lr"), (2, "lr")] and assembler.counters.late == 0


def test_frame_of_a_released_cycle_is_late_and_cycles_never_go_back():
    cycles, assembler = run([hello(2), echo(0, 1), echo(0, 2), echo(1, 1), echo(1, 2), echo(0, 3), echo(1, 3)])
    assert shape(cycles) == [(1, "l"), (2, "lr"), (3, "lr")]
    assert assembler.counters.late == 1 and assembler.counters.incomplete == 1


def test_repeated_frame_in_a_cycle_keeps_the_first():
    second = Echo(sensor=0, sequence=99, trigger=1, fop_hz=53_000.0, odr=6, mode=0, iq=np.zeros((4, 2), np.int16))
    cycles, assembler = run([hello(2), echo(0, 1), second, echo(1, 1)])
    assert cycles[0].frames["left"].sequence == 1 and assembler.counters.repeated == 1


def test_lost_triggers_are_counted():
    _, assembler = run([hello(1), echo(0, 1), echo(0, 2), echo(0, 6)])
    assert assembler.counters.missing == 3 and assembler.counters.cycles == 3


def test_flush_releases_the_last():
    cycles, assembler = run([hello(2), echo(0, 1)])
    assert cycles == []
    last = assembler.flush()
    assert last is not None and shape([last]) == [(1, "l")] and assembler.flush() is None


def test_clock_unwraps_over_hours():
    """Six hours at 39 Hz cross the 71.6 min wrap five times; every cycle is 25.6 ms after the one before."""
    assembler = CycleAssembler()
    assembler.add(hello(1))
    times = []
    for trigger in range(0, 850_000, 5_000):
        cycle = assembler.add(echo(0, trigger))
        assert cycle is not None
        times.append(cycle.t_us)
    assert np.all(np.diff(times) == 5_000 * 25_600) and times[-1] > 5 * (1 << 32)


def test_clock_may_step_back_a_little_between_sensors():
    """Sensors read one after the other may stamp out of order across the wrap."""
    cycles, _ = run([hello(2), echo(0, 1, (1 << 32) + 5), echo(1, 1, (1 << 32) - 5),
                     echo(0, 2, (1 << 32) + 25_605), echo(1, 2, (1 << 32) + 25_595)])
    first, second = cycles
    assert first.frames["right"].device_time_us - first.frames["left"].device_time_us == -10
    assert second.t_us - first.t_us == 25_600


def test_trigger_wraps():
    cycles, assembler = run([hello(1), echo(0, 0xFFFFFFFF), echo(0, 0)])
    assert shape(cycles) == [(0xFFFFFFFF, "l"), (0, "l")] and assembler.counters.missing == 0


@pytest.mark.parametrize("says_so", [True, False])
def test_restarted_rig_is_followed(says_so):
    boot = [hello(2, flags=FLAG_BOOT)] if says_so else []
    cycles, assembler = run([hello(2), echo(0, 900), echo(1, 900), echo(0, 901), *boot, echo(0, 0), echo(1, 0),
                             echo(0, 1), echo(1, 1)])
    assert shape(cycles) == [(900, "lr"), (901, "l"), (0, "lr"), (1, "lr")]
    assert [c.t_us for c in cycles[2:]] == [0, 25_600] and assembler.counters.late == 0


@settings(max_examples=80, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 2), st.booleans()), max_size=90))
def test_every_frame_ends_in_one_cycle_or_one_counter(events):
    """Any interleaving: cycles in strictly rising order, no frame invented, none lost without account."""
    assembler = CycleAssembler()
    assembler.add(hello(3))
    trigger, sent, cycles = 0, 0, []
    for sensor, step in events:
        trigger += step
        cycle = assembler.add(echo(sensor, trigger))
        sent += 1
        if cycle is not None:
            cycles.append(cycle)
    last = assembler.flush()
    cycles += [last] if last is not None else []
    triggers = [c.trigger for c in cycles]
    assert triggers == sorted(set(triggers))
    assert all(f.trigger == c.trigger for c in cycles for f in c.frames.values())
    assert sent == sum(len(c.frames) for c in cycles) + assembler.counters.late + assembler.counters.repeated
    assert len(cycles) == assembler.counters.cycles
