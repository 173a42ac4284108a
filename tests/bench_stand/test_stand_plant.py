"""The emulated motor and propeller: it reproduces the real sweeps it was fitted to, and behaves like a motor."""

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bench.thrust_stand.fitting import fit_plant, plant_text
from bench.thrust_stand.formats import read_sweep
from bench.thrust_stand.plant import Plant, load_plant
from bench.thrust_stand.plant_file import load_plant_file
from saranga.errors import UsageError
from saranga.fixtures import fixture_dir, fixture_names

SWEEPS = fixture_dir() / "thrust" / "rcbenchmark-1520"
NAMES = ["a1", "a5", "b5", "c5", "d3", "e2", "f4", "g1"]


def test_every_real_combination_has_a_plant() -> None:
    assert fixture_names("thrust") == NAMES
    assert (SWEEPS / "LICENSE").read_text().startswith("MIT License")


@pytest.mark.parametrize("name", NAMES)
def test_the_plant_file_is_what_the_fit_of_its_sweeps_gives(name: str) -> None:
    source = load_plant_file(name).source
    tables = fit_plant([SWEEPS / f for f in source.files], name, source.description, source.licence, 0.127, 3)
    again = tomllib.loads(plant_text(tables))
    committed = tomllib.loads((fixture_dir() / "thrust" / f"{name}.toml").read_text())
    assert again.keys() == committed.keys()
    for table, entries in committed.items():
        for key, value in entries.items():
            if isinstance(value, str) or (value and isinstance(value, list) and isinstance(value[0], str)):
                assert again[table][key] == value
            else:
                assert again[table][key] == pytest.approx(value, rel=2e-3, abs=1e-9), f"{table}.{key}"


@pytest.mark.parametrize("name", NAMES)
def test_the_plant_at_rest_on_each_throttle_agrees_with_the_real_sweep(name: str) -> None:
    sweep = read_sweep(SWEEPS / f"{name}_11.csv").quantities
    plant = load_plant(name, noise=None)
    throttle = (sweep["esc_s"] - 1e-3) / 1e-3
    states = [plant.steady(float(u)) for u in throttle]
    turning = sweep["rpm"] > 2500.0
    limited = sweep["current_a"] > 10.85  # where the supply of the sweep gave no more, all follows its voltage
    free = turning & ~limited
    most_n = sweep["thrust_n"].max()
    thrust, rpm, volts, current = (
        np.array([getattr(s, key) for s in states]) for key in ("thrust_n", "rpm", "voltage_v", "current_a"))
    assert np.abs(thrust - sweep["thrust_n"])[free].max() < 0.05 * most_n
    assert np.sqrt(np.mean((rpm[free] / sweep["rpm"][free] - 1.0) ** 2)) < 0.025
    assert np.abs(volts - sweep["voltage_v"])[free].max() < 0.1
    assert np.sqrt(np.mean((current - sweep["current_a"])[free] ** 2)) < 0.5
    assert np.abs(thrust - sweep["thrust_n"])[turning].max() < 0.2 * most_n
    assert (volts[limited] < 10.4).all() and (current[limited] > 10.8).all()


def test_same_seed_same_readings_and_another_seed_other_noise() -> None:
    def readings(seed: int) -> list[object]:
        plant = load_plant("g1", seed=seed)
        return [plant.step(0.02, 0.3) for _ in range(50)]

    assert readings(1) == readings(1)
    assert readings(1) != readings(2)


def test_noise_has_the_size_it_says_and_no_bias() -> None:
    plant = load_plant("g1", seed=3)
    for _ in range(100):
        plant.step(0.02, 0.5)
    errors = []
    for _ in range(400):
        reading = plant.step(0.02, 0.5)
        errors.append(reading.thrust_n - plant.truth.thrust_n)
    assert np.std(errors) == pytest.approx(0.004, rel=0.15)
    assert abs(np.mean(errors)) < 4 * 0.004 / 20


def test_steps_of_any_length_end_at_the_same_state() -> None:
    fine, coarse = load_plant("g1", noise=None), load_plant("g1", noise=None)
    for _ in range(1000):
        fine.step(0.002, 0.6)
    for _ in range(4):
        coarse.step(0.5, 0.6)
    assert coarse.truth.rpm == pytest.approx(fine.truth.rpm, rel=1e-4)
    assert coarse.truth.thrust_n == pytest.approx(plant_steady(0.6), rel=1e-3)
    assert coarse.truth.time_s == pytest.approx(2.0)


def plant_steady(throttle: float) -> float:
    return load_plant("g1", noise=None).steady(throttle).thrust_n


def test_motor_stands_below_its_start_and_spins_down_to_nothing() -> None:
    plant = load_plant("g1", noise=None)
    assert plant.step(1.0, 0.0).rpm == 0.0
    assert plant.step(1.0, 0.029).rpm == 0.0
    assert plant.step(1.0, 0.03).rpm > 1000.0
    plant.step(1.0, 0.7)
    half_a_second = plant.step(0.5, 0.0)
    assert half_a_second.thrust_n < 0.01 * plant_steady(0.7)


def test_heat_rises_with_load_and_falls_at_rest() -> None:
    plant = load_plant("a1", noise=None)
    for _ in range(60):
        plant.step(1.0, 0.8)
    hot = plant.truth
    assert hot.motor_temperature_c > 40.0 and hot.esc_temperature_c > 21.0
    for _ in range(300):
        plant.step(1.0, 0.0)
    assert 20.0 <= plant.truth.motor_temperature_c < hot.motor_temperature_c - 10.0


def test_a_battery_sags_and_runs_down_where_the_supply_does_not() -> None:
    pack = load_plant("g1", noise=None, cells=3, capacity_ah=0.85)
    supply = load_plant("g1", noise=None)
    first = pack.step(1.0, 0.6)
    for _ in range(120):
        pack.step(5.0, 0.6)
        supply.step(5.0, 0.6)
    assert pack.truth.voltage_v < first.voltage_v - 0.3
    assert pack.truth.thrust_n < first.thrust_n
    assert supply.truth.voltage_v == pytest.approx(supply.steady(0.6).voltage_v, abs=0.02)


def test_a_bent_propeller_shakes_more() -> None:
    true, bent = load_plant("g1", noise=None), load_plant("g1", noise=None, imbalance=5.0)
    assert bent.step(2.0, 0.6).vibration_m_s2 > 2.0 * true.step(2.0, 0.6).vibration_m_s2


@pytest.mark.parametrize("throttle", [-0.01, 1.01, float("nan"), float("inf")])
def test_a_throttle_outside_its_limits_is_refused(throttle: float) -> None:
    with pytest.raises(UsageError, match=r"throttle is .*: it must be 0\.\.1"):
        load_plant("g1").step(0.02, throttle)


@pytest.mark.parametrize(("options", "words"), [
    ({"cells": 3}, "cells and capacity_ah"),
    ({"charge": 1.5}, "charge is 1.5"),
    ({"ambient_c": float("nan")}, "ambient_c is nan"),
])
def test_impossible_plants_are_refused(options: dict[str, float], words: str) -> None:
    with pytest.raises(UsageError, match=words):
        load_plant("g1", **options)


def test_a_plant_file_with_a_fault_names_file_table_and_key(tmp_path: Path) -> None:
    text = (fixture_dir() / "thrust" / "g1.toml").read_text()
    path = tmp_path / "mine.toml"
    path.write_text(text.replace("thrust_n_per_rpm2 = ", "thrust_n_per_rpm2 = -"))
    with pytest.raises(UsageError, match=r"mine\.toml: \[propeller\] thrust_n_per_rpm2"):
        load_plant_file(str(path))
    path.write_text(text.split("[heat]")[0])
    with pytest.raises(UsageError, match=r"mine\.toml: table \[heat\] is missing"):
        load_plant_file(str(path))
    with pytest.raises(UsageError, match="did you mean 'g1'"):
        load_plant_file("g11")


def test_a_stronger_propeller_is_stronger() -> None:
    file = load_plant_file("g1")
    strong = replace_thrust(file, 2.0)
    assert Plant(strong, noise=None).step(2.0, 0.5).thrust_n == pytest.approx(
        2.0 * Plant(file, noise=None).step(2.0, 0.5).thrust_n)


def replace_thrust(file, factor: float):
    propeller = file.propeller.model_copy(update={"thrust_n_per_rpm2": factor * file.propeller.thrust_n_per_rpm2})
    return file.model_copy(update={"propeller": propeller})


def test_readings_are_plain_numbers() -> None:
    reading = load_plant("g1").step(0.02, 0.5)
    assert all(type(v) in (float, int) for v in vars(replace(reading)).values())
