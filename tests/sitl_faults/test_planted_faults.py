"""Faults found by name: what they accept, and what each does to the bytes, the sensors and the physics."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from saranga.assembler import CycleAssembler
from saranga.echo import load_sonar
from saranga.errors import UsageError
from saranga.wire import Decoder, Echo
from sitl.acoustics.shield import load_shielding
from sitl.acoustics.sonar import AcousticModel
from sitl.airframe import load_airframe
from sitl.faults import Planting, build_fault, fault_modules
from sitl.faults.planted import PlantedFaults
from sitl.live import run_live_trial
from sitl.physics import Physics
from sitl.rig import RigFaults, VirtualRig
from sitl.scene import build_scene, load_scene
from sitl.sensors import FlightSensors
from sitl.trial_types import Faults, TrialRequest

STILL = (np.array([2.0, 0.0, -1.0]), np.array([1.0, 0, 0, 0]), np.zeros(3), np.full(4, 1.1))


@pytest.fixture(scope="module")
def model() -> AcousticModel:
    scene = build_scene(load_scene("wall"), 1)
    return AcousticModel(scene.primitives, scene.weather, load_sonar("pair"), load_shielding("foam"), 1)


def echoes(model: AcousticModel, cycles: int = 1, **faults: Any) -> list[Echo]:
    rig = VirtualRig(model, load_sonar("pair"), RigFaults(**faults))
    data = b"".join(rig.cycle(k, k * 25_600, *STILL) for k in range(cycles))
    return [m for m in Decoder().feed(data) if isinstance(m, Echo)]


def test_every_fault_says_what_it_is() -> None:
    modules = fault_modules()
    assert len(modules) >= 14
    for name, module in modules.items():
        low, high = module.RANGE
        assert module.SUMMARY and module.UNIT and low <= high
        assert build_fault(Planting(name, high)).value == high
        assert name not in vars(Faults()), "a fault of the same name would never be planted"


def test_faults_read_back_what_they_say() -> None:
    asked = Faults.parse(["flow_lost=1@3", "gust_m_s=1.5", "dead_sensor=right"])
    assert asked.planted == (Planting("flow_lost", 1.0, 3.0), Planting("gust_m_s", 1.5))
    said = asked.to_dict()
    assert said == {"dead_sensor": "right", "flow_lost": "1@3", "gust_m_s": "1.5"}
    assert Faults.parse([f"{k}={v}" for k, v in said.items()]) == asked and asked.any()


@pytest.mark.parametrize(("text", "words"), [
    ("flow_lots=1", "did you mean 'flow_lost'"), ("gust_m_s=99", "within 0 .. 15 m/s"),
    ("gust_m_s=x", "must be a number"),
    ("gust_m_s=1@-2", "not negative"), ("gust_m_s=1@", "time after @"), ("motor_thrust=nan", "must be finite")])
def test_a_bad_fault_is_one_clear_error(text: str, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        Faults.parse([text])
    with pytest.raises(UsageError, match="given twice"):
        Faults.parse(["gust_m_s=1", "gust_m_s=2"])


def test_swapped_sensors_change_sides_and_nothing_else(model: AcousticModel) -> None:
    plain, swapped = echoes(model), echoes(model, swapped=True)
    assert [e.sensor for e in swapped] == [0, 1]
    assert np.array_equal(plain[0].iq, swapped[1].iq) and np.array_equal(plain[1].iq, swapped[0].iq)
    assert not np.array_equal(plain[0].iq, plain[1].iq)


def test_gain_is_cut_off_at_the_converters_limit(model: AcousticModel) -> None:
    most = load_sonar("pair").saturation_counts
    plain, loud = echoes(model)[0].iq, echoes(model, gain_db=60.0)[0].iq
    assert np.abs(loud).max() == most and (np.abs(loud) == most).mean() > 0.2
    small = np.abs(plain.astype(float)) * 10 ** (6 / 20) < most
    quiet = echoes(model, gain_db=6.0)[0].iq
    assert np.array_equal(quiet[small], np.rint(plain * 10 ** (6 / 20)).astype(np.int16)[small])


def test_a_lost_cycle_is_lost_whole_and_leaves_a_gap(model: AcousticModel) -> None:
    kept = echoes(model, cycles=40, cycle_drop_probability=0.5)
    triggers = [e.trigger for e in kept]
    assert 10 < len(set(triggers)) < 30 and all(triggers.count(t) == 2 for t in triggers)
    assert all(e.sequence == e.trigger for e in kept)
    assert not echoes(model, cycles=5, cycle_drop_probability=1.0)


def test_a_jump_of_the_rigs_clock_costs_no_cycle(model: AcousticModel) -> None:
    rig, decoder, assembler = VirtualRig(model, load_sonar("pair")), Decoder(), CycleAssembler()
    cycles = []
    assembler.add(*decoder.feed(rig.hello()))
    for k in range(12):
        if k == 6:
            rig.faults = RigFaults(clock_offset_us=-100_000)
        for message in decoder.feed(rig.cycle(k, 1_000_000 + k * 25_600, *STILL)):
            done = assembler.add(message)
            cycles += [done] if done is not None else []
    assert [c.trigger for c in cycles] == list(range(len(cycles))) and len(cycles) >= 10


def test_setpoints_lost_and_stale() -> None:
    lost, stale = (PlantedFaults([Planting(name, 1, 2.0)]) for name in ("setpoints_lost", "setpoints_stale"))
    world: Any = SimpleNamespace()
    for faults in (lost, stale):
        faults.step(world, 1.9)
        assert faults.setpoints(b"one") == b"one"
        faults.step(world, 2.0)
    assert lost.setpoints(b"two") == b""
    assert stale.setpoints(b"two") == b"one" and stale.setpoints(b"") == b""


def test_the_companions_clock_jumps_once_it_is_due() -> None:
    faults = PlantedFaults([Planting("stack_clock_jump_ms", -500.0, 1.0)])
    world: Any = SimpleNamespace()
    faults.step(world, 0.5)
    assert faults.clock_us(1_000_000) == 1_000_000
    faults.step(world, 1.0)
    assert faults.clock_us(2_000_000) == 1_500_000


def test_sensors_motor_battery_and_gusts() -> None:
    airframe = load_airframe()
    world: Any = SimpleNamespace(sensors=FlightSensors(1), physics=Physics(airframe, seed=3),
                                 geometry=load_sonar("pair"), rig=SimpleNamespace(faults=RigFaults()), shields=[])
    world.change_shield = world.shields.append
    PlantedFaults([Planting(name, value) for name, value in (
        ("flow_lost", 1), ("range_lost", 1), ("motor_thrust", 0.6), ("battery_charge", 0.25), ("gust_m_s", 2.0),
        ("shield_lost", 1), ("cycles_late_ms", 80), ("cycles_dropped", 0.3), ("receiver_gain_db", 20),
        ("rig_clock_jump_ms", -7))]).step(world, 0.0)
    assert not world.sensors.flow_enabled and not world.sensors.range_enabled and world.shields == ["none"]
    assert world.physics.motor_scale.tolist() == [0.6, 1, 1, 1] and world.physics.charge == 0.25
    assert world.rig.faults == RigFaults(delay_us=80_000, cycle_drop_probability=0.3, gain_db=20,
                                         clock_offset_us=-7000)
    air = []
    for _ in range(400):
        world.physics.step(2_500, np.zeros(4))
        air.append(world.physics.wind_m_s[:2].copy())
    assert 0.5 < float(np.std(air)) < 4.0


def test_swapping_what_is_not_there_is_refused() -> None:
    world: Any = SimpleNamespace(geometry=load_sonar("batdeck"), sonar="batdeck",
                                 rig=SimpleNamespace(faults=RigFaults()))
    with pytest.raises(UsageError, match="has only"):
        PlantedFaults([Planting("sensors_swapped", 1)]).step(world, 0.0)


def test_a_fault_inside_the_stack_is_refused_in_live_mode() -> None:
    with pytest.raises(UsageError, match="stack_clock_jump_ms acts inside the stack"):
        run_live_trial(TrialRequest("open", faults=Faults.parse(["stack_clock_jump_ms=5"])))
