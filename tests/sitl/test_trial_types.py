"""What goes into a trial and comes out of it survives being written and read."""

import json
from pathlib import Path

import numpy as np
import pytest

from saranga.errors import UsageError
from saranga.localise import Obstacle
from sitl.trial_types import Faults, FlightLog, TrialRequest, TrialResult


def flight_log() -> FlightLog:
    ticks = 4
    rng = np.random.default_rng(1)
    pixels = [rng.integers(0, 256, (ticks, 16), dtype=np.uint8) for _ in range(4)]
    seen = Obstacle(range_m=1.2, azimuth_rad=-0.3, elevation_rad=0.1, x_m=1.1, y_m=-0.3, z_m=0.1, score=0.8)
    near = Obstacle(range_m=0.4, azimuth_rad=0.0, elevation_rad=0.0, x_m=0.4, y_m=0.0, z_m=0.0, score=1.0)
    return FlightLog(
        t_us=np.arange(ticks, dtype=np.int64) * 62_500, pos_m=rng.normal(size=(ticks, 3)),
        vel_m_s=rng.normal(size=(ticks, 3)), quat=rng.normal(size=(ticks, 4)), thrust_n=rng.normal(size=(ticks, 4)),
        phase=["takeoff", "course", "course", "land"], command=rng.normal(size=(ticks, 4)),
        envelope_left=pixels[0], envelope_right=pixels[1], edges_left=pixels[2], edges_right=pixels[3],
        obstacles=[[], [near, seen], [], [seen]], airframe={"radius_m": np.float64(0.12)},
        scene={"obstacles": [{"x": 3.0}]}, events=[(1_000_000, "armed – ü")])


def test_log_comes_back_bit_for_bit(tmp_path: Path) -> None:
    log = flight_log()
    got = FlightLog.load(log.save(tmp_path / "new" / "flight.npz"))
    for name in ("t_us", "pos_m", "vel_m_s", "quat", "thrust_n", "command", "envelope_left", "envelope_right",
                 "edges_left", "edges_right"):
        want = getattr(log, name)
        assert getattr(got, name).dtype == want.dtype
        assert np.array_equal(getattr(got, name), want), name
    assert (got.phase, got.obstacles, got.events) == (log.phase, log.obstacles, log.events)
    assert (got.airframe, got.scene) == ({"radius_m": 0.12}, {"obstacles": [{"x": 3.0}]})
    assert [p.name for p in (tmp_path / "new").iterdir()] == ["flight.npz"]


def test_log_without_a_tick_comes_back(tmp_path: Path) -> None:
    log = flight_log()
    for name in ("t_us", "pos_m", "quat", "envelope_left"):
        setattr(log, name, getattr(log, name)[:0])
    log.phase, log.obstacles = [], []
    got = FlightLog.load(log.save(tmp_path / "x.npz"))
    assert (len(got.t_us), got.pos_m.shape, got.obstacles) == (0, (0, 3), [])


@pytest.mark.parametrize("keep", [0, 10, 500, -40])
def test_a_cut_log_says_so(tmp_path: Path, keep: int) -> None:
    path = flight_log().save(tmp_path / "x.npz")
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(UsageError, match="not a readable flight log"):
        FlightLog.load(path)


def test_a_missing_log_says_so(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="does not exist"):
        FlightLog.load(tmp_path / "x.npz")


def test_faults_from_the_command_line() -> None:
    got = Faults.parse(["echo_silent_at_s=12", "dead_sensor=right", "dead_sensor_at_s = 5.5", "drop_probability=1"])
    assert got == Faults(echo_silent_at_s=12.0, dead_sensor="right", dead_sensor_at_s=5.5, drop_probability=1.0)
    assert got.any()
    assert got.to_dict() == {"echo_silent_at_s": 12.0, "dead_sensor": "right", "dead_sensor_at_s": 5.5,
                             "drop_probability": 1.0}
    assert Faults.parse([f"{k}={v}" for k, v in got.to_dict().items()]) == got
    assert not Faults.parse([]).any()


def test_a_fault_at_the_very_start_is_a_fault() -> None:
    assert Faults.parse(["nan_policy_at_s=0"]).to_dict() == {"nan_policy_at_s": 0.0}


@pytest.mark.parametrize(("texts", "says"), [
    (["echo_silent"], "did you mean 'echo_silent_at_s'"), (["kill_autopilot_at_s="], "no value"),
    (["drop_probability=1.5"], "at most 1"), (["setpoint_delay_ms=-1"], "not negative"),
    (["setpoint_delay_ms=inf"], "finite"), (["setpoint_delay_ms=a"], "must be a number"),
    (["dead_sensor=up"], "left, right or down"), (["dead_sensor_at_s=3"], "needs dead_sensor"),
    (["drop_probability=0.1", "drop_probability=0.2"], "twice"),
])
def test_a_fault_that_cannot_be_is_refused(texts: list[str], says: str) -> None:
    with pytest.raises(UsageError, match=says):
        Faults.parse(texts)


def test_result_is_json_without_what_json_lacks() -> None:
    result = TrialResult(
        scene="open", seed=1, outcome="clean", cause="", part=None, success_strict=True, success_lenient=True,
        min_clearance_m=float("inf"), duration_s=np.float64(9.0), sim_s=30.0, wall_s=1.0,  # type: ignore[arg-type]
        realtime_factor=float("nan"), determinism_hash="ab", landed=True, autopilot={"kind": "embedded"},
        denoiser="tbd", stack="saranga", shield="foam", link_counters={"bad_crc": np.int64(3)},
        timing={"denoise": float("nan")}, log=flight_log(), files={"log": "x"})
    got = json.loads(json.dumps(result.to_dict(), allow_nan=False))
    assert (got["min_clearance_m"], got["realtime_factor"], got["timing"]) == (None, None, {"denoise": None})
    assert (got["duration_s"], got["link_counters"]["bad_crc"]) == (9.0, 3)
    assert "log" not in got


def test_request_for_the_journal_names_all_that_changes_a_flight() -> None:
    one = TrialRequest("poles", 1)
    assert one.to_dict() == TrialRequest("poles", 1, workdir=Path("/x"), keep_log=False).to_dict()
    for change in ({"seed": 2}, {"stack": "none"}, {"faults": Faults(dead_sensor="left")}, {"max_sim_s": 9.0}):
        assert TrialRequest(**({"scene": "poles", "seed": 1} | change)).to_dict() != one.to_dict()  # type: ignore
