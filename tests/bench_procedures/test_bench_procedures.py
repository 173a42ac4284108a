"""Sensor accuracy, beam pattern, reference echo and energy: against numbers worked out beforehand."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bench.procedures.accuracy import accuracy_of, accuracy_result, read_csv, read_mavlink, read_rig
from bench.procedures.beam import beam_point, beam_result, places, two_way_width_deg
from bench.procedures.echo_bench import EmulatedEchoBench, Place
from bench.procedures.plan import BeamPlan, EchoPlan, plan_from_tables
from bench.procedures.reference_echo import capture_echo
from saranga.errors import DeviceError, UsageError
from saranga.synthesis.responses import build_responses

RIG = {"frames": 10, "rate_hz": 39.0}


def test_accuracy_is_the_papers_formula() -> None:
    # errors 0.1, 0, 1 (undefined), 1 (zero), 0.5
    found = accuracy_of([1.1, 1.0, math.nan, 0.0, 1.5], 1.0)
    assert found.accuracy == pytest.approx(1.0 - (0.1 + 0.0 + 1.0 + 1.0 + 0.5) / 5)
    assert (found.readings, found.undefined) == (5, 2)
    assert found.bias_m == pytest.approx(0.2)
    assert accuracy_of([4.0, 4.0], 1.0).accuracy == pytest.approx(-2.0)  # as printed; the cap stands beside it
    assert accuracy_of([4.0, 4.0], 1.0).capped == pytest.approx(0.0)
    assert accuracy_of([math.nan] * 4, 1.0).bias_m is None
    low, high = accuracy_of([1.05, 0.95] * 50, 1.0).interval
    assert low <= 0.95 <= high
    with pytest.raises(UsageError, match="no reading"):
        accuracy_of([], 1.0)
    with pytest.raises(UsageError, match="positive"):
        accuracy_of([1.0], math.nan)


def test_rangers_are_read_from_csv_files(tmp_path: Path) -> None:
    path = tmp_path / "lidar.csv"
    path.write_text("\ufefftime,distance_mm,strength\n0,1000,5\n1,,5\n2,inf,5\n3,1100,5\n")
    readings = read_csv(path, None, 0.001)
    assert readings.values_m[0] == pytest.approx(1.0)
    assert readings.origin == "recorded"
    assert accuracy_result(readings, 1.0)["undefined"] == 2
    with pytest.raises(UsageError, match="distance_mm"):
        read_csv(path, "range")
    with pytest.raises(UsageError, match="cannot be read"):
        read_csv(tmp_path / "absent.csv", None)
    path.write_text("a,b\n1,2\n")
    with pytest.raises(UsageError, match="--column"):
        read_csv(path, None)


def test_rangers_are_read_from_mavlink_logs(tmp_path: Path) -> None:
    from pymavlink.dialects.v20 import ardupilotmega as mavlink

    path = tmp_path / "flight.tlog"
    link = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    messages = [mavlink.MAVLink_distance_sensor_message(0, 20, 400, cm, 0, 1, 0, 0) for cm in (100, 90, 500)]
    far = [65_535] * 72
    near = [*far]
    near[3], near[4] = 120, 110
    for distances in (near, far):
        messages.append(mavlink.MAVLink_obstacle_distance_message(0, 0, distances, 5, 20, 400))
    with path.open("wb") as file:
        for k, message in enumerate(messages):
            file.write((1_700_000_000_000_000 + 1000 * k).to_bytes(8, "big") + message.pack(link))
    sensor = read_mavlink(path, "DISTANCE_SENSOR")
    assert sensor.values_m[:2] == pytest.approx((1.0, 0.9))
    assert math.isnan(sensor.values_m[2])
    sectors = read_mavlink(path, "OBSTACLE_DISTANCE")
    assert sectors.values_m[0] == pytest.approx(1.1)
    assert math.isnan(sectors.values_m[1])
    with pytest.raises(UsageError, match="no DISTANCE_SENSOR of sensor 7"):
        read_mavlink(path, "DISTANCE_SENSOR", 7)
    with pytest.raises(UsageError, match="does not exist"):
        read_mavlink(tmp_path / "absent.tlog", "DISTANCE_SENSOR")


def beam_plan(**changes: object) -> BeamPlan:
    plan = plan_from_tables({"name": "b", "procedure": "beam", "distances_m": [0.8], "azimuths_deg": [-60.0, 0.0, 60.0],
                             "rig": RIG, **changes}, "test plan")
    assert isinstance(plan, BeamPlan)
    return plan


def test_the_beam_of_the_emulated_horn_falls_to_the_sides() -> None:
    plan = beam_plan(repeats=2)
    order = places(plan)
    assert len(order) == 6
    assert order == places(plan)
    bench = EmulatedEchoBench(plan.rig)
    points = [beam_point(bench.cycles(p, plan.rig.frames), p, plan, r) for r, p in order[:3]]
    result = beam_result(points, plan, bench.origin)
    pattern = result["pattern_db"]["0.8"]
    assert result["origin"] == "emulated"
    assert pattern["0"] == 0.0
    # one way -3 dB at 70 degrees: two way -4.3 at 60, and the pole is not quite as far from the left sensor
    assert -6.5 < pattern["60"] < -2.5
    assert -6.5 < pattern["-60"] < -2.5
    assert all(p.seen for p in points)


def test_beam_widths_are_interpolated_and_not_guessed() -> None:
    assert two_way_width_deg([-60.0, -30.0, 0.0, 30.0, 60.0], [-12.0, -3.0, 0.0, -3.0, -12.0]) == pytest.approx(80.0)
    assert two_way_width_deg([-30.0, 0.0, 30.0], [-3.0, 0.0, -3.0]) is None
    with pytest.raises(UsageError, match="rings"):
        beam_plan(distances_m=[0.1])


def test_a_reference_echo_is_one_that_synthesis_takes(tmp_path: Path) -> None:
    plan = plan_from_tables({"name": "e", "procedure": "echo", "object": "pole", "distance_m": 1.0,
                             "rig": {"frames": 20, "rate_hz": 39.0}}, "test plan")
    assert isinstance(plan, EchoPlan)
    recording = tmp_path / "echoes.mcap"
    found = capture_echo(plan, EmulatedEchoBench(plan.rig, record=recording), recording)
    assert found["range_m"] == pytest.approx(1.0, abs=0.03)
    assert found["origin"] == "emulated"
    built = build_responses([{"name": "pole", "file": str(recording)}], [4000.0], 343.0, 0.5, 3980.0)
    assert built.names == ("pole",)
    # 1.0 m to the surface, and the ranging of the accuracy procedure finds it in every cycle
    readings = read_rig(recording, "left")
    assert len(readings.values_m) >= 20
    assert accuracy_of(readings.values_m, 1.0).accuracy > 0.97
    away = plan.model_copy(update={"distance_m": 1.4})

    class Elsewhere(EmulatedEchoBench):
        def cycles(self, place: Place, count: int):  # type: ignore[no-untyped-def]
            return super().cycles(Place(1.0), count)

    with pytest.raises(DeviceError, match=r"strongest echo is at 1\.0"):
        capture_echo(away, Elsewhere(plan.rig, record=tmp_path / "other.mcap"), tmp_path / "other.mcap")
    assert (tmp_path / "other.mcap").is_file()


def test_silence_is_no_reference_echo(tmp_path: Path) -> None:
    plan = plan_from_tables({"name": "e", "procedure": "echo", "object": "pole", "rig": RIG}, "test plan")
    assert isinstance(plan, EchoPlan)

    class Silence(EmulatedEchoBench):
        def cycles(self, place: Place, count: int):  # type: ignore[no-untyped-def]
            rng = np.random.default_rng(2)
            cycles = super().cycles(Place(1.0), count)
            noise = {role: np.rint(40.0 * rng.standard_normal((count, *f.iq.shape))).astype("i2")
                     for role, f in cycles[0].frames.items()}
            return [replace(c, frames={role: replace(f, iq=noise[role][k]) for role, f in c.frames.items()})
                    for k, c in enumerate(cycles)]

    with pytest.raises(DeviceError, match="no echo stands out"):
        capture_echo(plan, Silence(plan.rig), tmp_path / "echoes.mcap")
