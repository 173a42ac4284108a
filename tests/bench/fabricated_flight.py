"""FABRICATED: a made-up flight for tests of drawing only. Nothing in it was flown or simulated.

A slalom around four poles with echo rows whose bright edges lie where the geometry puts them, over noise.
"""

from typing import Any

import numpy as np

from saranga.echo import COLUMN_M, RANGE_COLUMNS
from saranga.localise import Obstacle
from sitl.trial_types import FlightLog, TrialResult

POLES = ((3.0, 0.15), (5.0, -0.7), (6.2, 0.75), (7.9, -0.1))
DIAMETER_M = 0.06
TICK_US = 62_500


def scene_dict() -> dict[str, Any]:
    """A scene as `Scene.to_dict` writes it."""
    return {
        "name": "fabricated", "seed": 7,
        "arena": {"x_m": [0.0, 11.0], "y_m": [-2.25, 2.25], "height_m": 3.65, "netted": True},
        "course": {"start_m": [1.0, 0.0, 0.0], "goal_x_m": 10.0, "height_m": 1.0, "speed_m_s": 1.0,
                   "timeout_s": 60.0},
        "obstacles": [{"kind": "cylinder", "x_m": x, "y_m": y, "diameter_m": DIAMETER_M, "height_m": 2.4,
                       "material": "pvc"} for x, y in POLES],
    }


def fabricated_log(hit: bool = False) -> FlightLog:
    """The log: 3 s take-off, about 9 s of course, landing (none when it `hit` the last pole)."""
    rng = np.random.default_rng(20)
    climb, course, land = 48, 144, 0 if hit else 40
    ticks = climb + course + land
    x = np.concatenate([np.full(climb, 1.0), np.linspace(1.0, 7.82 if hit else 10.1, course),
                        np.full(land, 10.1)])
    centre = np.array([0.0, 0.0, -0.42, 0.25, 0.05, 0.48 if not hit else -0.1, 0.2, 0.0])
    knots = np.array([0.0, 1.6, 3.0, 5.0, 6.2, 7.9, 9.2, 10.2])
    y = np.interp(x, knots, centre)
    y = np.convolve(np.pad(y, 8, mode="edge"), np.ones(17) / 17, mode="valid")
    height = np.concatenate([np.linspace(0.03, 1.0, climb), 1.0 + 0.02 * np.sin(np.arange(course) / 7.0),
                             np.linspace(1.0, 0.03, land)])
    position = np.stack([x, y, -height], axis=1)
    t_us = (np.arange(ticks) * TICK_US + 5_000_000).astype(np.int64)
    velocity = np.gradient(position, TICK_US * 1e-6, axis=0)
    roll = 0.16 * np.gradient(velocity[:, 1], TICK_US * 1e-6)
    quat = np.stack([np.cos(roll / 2), np.sin(roll / 2), 0 * roll, 0 * roll], axis=1)
    command = np.concatenate([np.roll(velocity, -2, axis=0), np.zeros((ticks, 1))], axis=1)
    command[:climb] = command[climb + course:] = 0.0
    phase = ["takeoff"] * climb + ["course"] * course + ["land"] * land
    rows = {side: rng.normal(52, 12, (ticks, RANGE_COLUMNS)).clip(0, 255) for side in ("left", "right")}
    edges = {side: np.zeros((ticks, RANGE_COLUMNS), dtype=np.uint8) for side in ("left", "right")}
    seen: list[list[Obstacle]] = []
    for tick in range(ticks):
        found = []
        for px, py in POLES:
            ahead, aside = px - x[tick] - 0.08, py - y[tick]
            if ahead <= 0.1:
                continue
            legs = {side: np.hypot(ahead, aside - off) - DIAMETER_M / 2
                    for side, off in (("left", -0.05), ("right", 0.05))}
            ranges = {"left": legs["left"], "right": (legs["left"] + legs["right"]) / 2}
            if max(ranges.values()) > 1.6:
                continue
            for side, value in ranges.items():
                column = int(value / COLUMN_M)
                tail = np.arange(RANGE_COLUMNS) - column
                pulse = np.where(tail >= 0, np.exp(-tail / 14.0) * (1 - np.exp(-(tail + 1) / 4.0)), 0.0)
                rows[side][tick] += 210 * pulse / max(0.5, value)
                edges[side][tick, max(0, column - 1):column + 2] = (150, 230, 150)
            azimuth = float(np.arctan2(aside, ahead))
            reach = float(np.mean(list(ranges.values())))
            found.append(Obstacle(reach, azimuth, 0.0, float(reach * np.cos(azimuth)),
                                  float(reach * np.sin(azimuth)), 0.0, 0.9))
        seen.append(sorted(found, key=lambda o: o.range_m))
    images = {side: value.clip(0, 255).astype(np.uint8) for side, value in rows.items()}
    start_us = int(t_us[0])
    events = [(start_us, "phase takeoff"), (int(t_us[climb]), "phase course")]
    if land:
        events.append((int(t_us[climb + course]), "phase land"))
    return FlightLog(
        t_us=t_us, pos_m=position, vel_m_s=velocity, quat=quat, thrust_n=np.full((ticks, 4), 1.13), phase=phase,
        command=command, envelope_left=images["left"], envelope_right=images["right"],
        edges_left=edges["left"], edges_right=edges["right"], obstacles=seen,
        airframe={"wheelbase_m": 0.16, "prop_diameter_m": 0.0762}, scene=scene_dict(), events=events)


def fabricated_result(hit: bool = False, log: FlightLog | None = None) -> TrialResult:
    """The result that goes with `fabricated_log(hit)`."""
    return TrialResult(
        scene="fabricated", seed=7, outcome="obstacle_hit" if hit else "clean",
        cause="propeller touched cylinder 4 at 7.82 m" if hit else "goal reached and landed",
        part="propeller" if hit else None, success_strict=not hit, success_lenient=not hit,
        min_clearance_m=0.0 if hit else 0.31, duration_s=9.0, sim_s=14.5, wall_s=0.7, realtime_factor=20.7,
        determinism_hash="fab0" * 16, landed=not hit, autopilot={"kind": "embedded", "version": "0.1.0"},
        denoiser="tbd", stack="saranga", shield="foam", log=log)
