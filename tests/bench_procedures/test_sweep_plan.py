"""Plans: what is refused, the order, the forecast and the hash."""

import itertools
import math
from pathlib import Path
from typing import Any

import pytest
from sweep_helpers import plan_of

from bench.procedures.emulated_device import parse_emulated
from bench.procedures.plan import NoisePlan, load_noise_plan, load_plan
from bench.procedures.schedule import forecast, plan_hash, schedule
from bench.supervisor import Limits
from saranga.errors import UsageError
from saranga.fixtures import fixture_names


@pytest.mark.parametrize(("change", "message"), [
    ({"levels": {"throttles": []}}, "empty sweep"),
    ({"levels": {"throttles": [0.2], "thrusts_n": [1.0]}}, "one of them"),
    ({"levels": {"throttles": [0.0, 0.5]}}, "over 0"),
    ({"levels": {"throttles": [0.5, 0.5]}}, "all different"),
    ({"levels": {"throttles": [math.nan]}}, "finite"),
    ({"levels": {"throttles": [0.95]}}, "0.95 is beyond limits.throttle = 0.9"),
    ({"levels": {"thrusts_n": [8.0]}}, "8 is beyond limits.thrust_n = 7"),
    ({"warm_up": {"throttle": 0.95, "duration_s": 1.0}}, "warm_up.throttle 0.95 is beyond"),
    ({"limits": {"throttle": 0.9}}, "thrust_n"),
    ({"limits": {"throttle": 0.9, "thrust_n": -7.0}}, "greater than 0"),
    ({"limits": {"throttle": 0.9, "thrust_n": 7.0, "curent_a": 9.0}}, "current_a"),
    ({"conditions": []}, "at least 1"),
    ({"conditions": [{"name": "none"}, {"name": "none"}]}, "different names"),
    ({"conditions": [{"name": "a", "reference": True}, {"name": "b", "reference": True}]}, "at most one"),
    ({"conditions": [{"name": "a", "shield": "foam", "reference": True}]}, "unshielded"),
    ({"conditions": [{"name": "../a"}]}, "pattern"),
    ({"rig": {"frames": 5}}, "frames"),
    ({"rig": {"samples": 32, "skip_samples": 20}}, "at least 16"),
    ({"settle": {"least_s": 5.0, "most_s": 4.0}}, "most_s"),
    ({"blocks": 0}, "blocks"),
    ({"metadata": {"temperature_c": math.nan}}, "metadata.temperature_c"),
    ({"procedure": "nosie"}, "noise"),
])
def test_a_plan_that_cannot_be_run_is_refused_by_name(change: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        plan_of(**change)


def test_every_shipped_plan_is_sound_and_its_limits_are_the_supervisors() -> None:
    names = fixture_names("plans")
    assert {"noise-sweep", "shield-comparison", "propeller-comparison", "sensor-distance", "shield-height",
            "beam-pattern", "reference-echo"} <= set(names)
    for name in names:
        plan = load_plan(name)
        assert plan.name == name
        assert len(plan_hash(plan)) == 16
        if isinstance(plan, NoisePlan):
            Limits(**{k: v for k, v in plan.limits.model_dump().items() if v is not None})
            assert len(schedule(plan)) > 0


def test_the_shipped_comparison_has_three_shields_three_blocks_eight_throttles() -> None:
    plan = load_noise_plan("shield-comparison")
    steps = schedule(plan)
    shielded = [s for s in steps if s.phase == "shielded"]
    assert len(shielded) == 3 * 3 * 8
    assert len([s for s in steps if s.phase == "reference"]) == 3 * 8
    for block in range(3):
        mine = [s for s in steps if s.block == block]
        assert mine[0].phase == "background" and mine[0].condition == "none"
        assert mine[-1].phase == "drift"
        for c in plan.conditions:
            levels = [s.level for s in mine if s.condition == c.name and s.phase in ("shielded", "reference")]
            assert sorted(levels) == sorted(plan.levels.values)
            assert levels != sorted(levels)  # random, and by the seed always so
    assert [s.step for s in steps] == list(range(len(steps)))


def test_order_and_hash_hang_on_the_seed_and_on_every_number_of_the_plan() -> None:
    one = plan_of()
    assert schedule(one) == schedule(plan_of())
    assert plan_hash(one) == plan_hash(plan_of())
    assert schedule(one) != schedule(plan_of(seed=2))
    for change in ({"seed": 2}, {"levels": {"throttles": [0.25, 0.45, 0.81]}}, {"blocks": 4},
                   {"limits": {"throttle": 0.9, "thrust_n": 7.5}}, {"metadata": {"propeller": "x"}}):
        assert plan_hash(plan_of(**change)) != plan_hash(one)


def test_full_order_remounts_for_every_change_of_shield() -> None:
    steps = schedule(plan_of(order="full", blocks=1))
    assert len(steps) == 3 + 9
    for a, b in itertools.pairwise(steps):
        assert (a.condition == b.condition) == (a.mounting == b.mounting)


def test_the_forecast_counts_time_peak_and_energy() -> None:
    plan = plan_of(limits={"throttle": 0.9, "thrust_n": 7.0, "current_a": 10.0})
    steps = schedule(plan)
    seen = forecast(plan, steps, by_hand=True, power_w={0.25: 10.0, 0.45: 20.0, 0.8: 60.0})
    # 9 mountings of 1 s; 27 spinning steps and 9 backgrounds of 0.6 + 0.2 + 20 / 50 s
    assert seen.steps == 36
    assert seen.mountings == 9
    assert seen.spinning_s == pytest.approx(27 * 1.2)
    assert seen.duration_s == pytest.approx(36 * 1.2 + 9.0)
    assert seen.peak_throttle == 0.8
    assert seen.energy_j == pytest.approx(9 * 1.2 * 90.0)
    assert seen.most_energy_j == pytest.approx(27 * 1.2 * 10.0 * 16.8)


def test_options_of_an_emulated_device_are_checked(tmp_path: Path) -> None:
    spec = parse_emulated("emulated:", "emulated:?propeller=g1&seed=4&shield=foam=9&shield=x=3&fault=negative_thrust")
    assert (spec.propeller, spec.seed, spec.shields, spec.faults) == ("g1", 4, ("foam=9", "x=3"), ("negative_thrust",))
    for url, message in (("emulated:?propellor=g1", "did you mean 'propeller'"), ("emulated:g1", "come options"),
                         ("emulated:?seed=x", "not a number")):
        with pytest.raises(UsageError, match=message):
            parse_emulated(url)
    with pytest.raises(UsageError, match="other URL"):
        parse_emulated("emulated:?seed=1", "emulated:?seed=2")
    (tmp_path / "broken.toml").write_text("name = ")
    with pytest.raises(UsageError, match="not valid TOML"):
        load_plan(str(tmp_path / "broken.toml"))
    with pytest.raises(UsageError, match="did you mean 'shield-height'"):
        load_plan("shield-hight")
