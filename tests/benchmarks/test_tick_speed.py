"""One physics tick of 2.5 ms, part by part, and one flight recording: the budget behind 20 times real time (125 us)."""

from typing import Any

import numpy as np
import pytest
from embedded_bench import Bench
from fabricated_flight import fabricated_log, fabricated_result

from bench.rerun_log import record_flight
from sitl.airframe import load_airframe
from sitl.judge import Judge
from sitl.physics import Physics, SteadyWind
from sitl.scene import build_scene, load_scene

TICK_US = 2500
TICKS = 400
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


def best_us(benchmark: Any, calls: int) -> float:
    """Quickest round: what the code costs when nothing else runs."""
    return float(benchmark.stats.stats.min / calls * 1e6)


@pytest.mark.benchmark(group="tick")
def test_physics_step(benchmark: Any) -> None:
    airframe = load_airframe()
    physics = Physics(airframe, (0.0, 0.0, -5.0), SteadyWind(2.0, 0.0, 1.0, 1.0))
    throttle = np.full(4, airframe.throttle_for(0.3))

    def steps() -> int:
        for _ in range(TICKS):
            physics.step(TICK_US, throttle)
        return physics.state.t_us

    assert benchmark(steps) >= TICKS * TICK_US
    assert best_us(benchmark, TICKS) < 10.0


@pytest.mark.benchmark(group="tick")
def test_judge_update(benchmark: Any) -> None:
    scene = build_scene(load_scene("poles"), 1)
    path_m = [scene.course.start_m + np.array([0.001 * k, 0.0, 0.0]) for k in range(TICKS)]

    def updates() -> Judge:
        judge = Judge(scene)
        for k, position_m in enumerate(path_m):
            judge.update(TICK_US * (k + 1), position_m, LEVEL)
        return judge

    assert not benchmark(updates).finished
    assert best_us(benchmark, TICKS) < 10.0


@pytest.mark.benchmark(group="tick")
def test_embedded_autopilot_step(benchmark: Any) -> None:
    """In the air, fed its sensors' messages; physics and sensors run outside the clock."""
    bench = Bench()
    bench.take_off(1.0)
    throttle = np.zeros(4)
    data = b""

    def sense() -> None:
        nonlocal data
        data = bench.sensors.step(bench.physics.state)

    def step() -> None:
        nonlocal throttle
        throttle, _ = bench.autopilot.step(bench.physics.state, data)

    def move() -> None:
        bench.physics.step(TICK_US, throttle)

    benchmark.pedantic(step, setup=sense, teardown=move, rounds=1000, warmup_rounds=100)
    assert bench.height_m > 0.5
    assert benchmark.stats.stats.median * 1e6 < 25.0


@pytest.mark.benchmark(group="recording")
def test_recording_of_a_flight(benchmark: Any, tmp_path: Any) -> None:
    log, result = fabricated_log(), fabricated_result()
    benchmark.pedantic(record_flight, args=(log, result, tmp_path / "f.rrd"), rounds=3)
    per_20_s = benchmark.stats.stats.min * 320 / len(log.t_us)
    benchmark.extra_info["seconds for a 20 s flight"] = round(per_20_s, 2)
    assert per_20_s < 1.5
