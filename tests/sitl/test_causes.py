"""Labels of fabricated flights, and where the echoes of a real one came from."""

from pathlib import Path

import numpy as np
import pytest

from saranga.localise import Obstacle
from sitl.causes import label_of
from sitl.echo_provenance import GROUND, NO_OBSTACLE, EchoProvenance, owners_of, provenance_of
from sitl.scene import build_scene, load_scene
from sitl.trial import run_trial
from sitl.trial_types import FlightLog, TrialRequest

POLE = {"kind": "cylinder", "x_m": 5.0, "y_m": 0.05, "height_m": 1.8, "diameter_m": 0.06}


def flight(seen_from_m: float | None = None, steer: float = 0.0, moved: float | None = None, past: bool = False
           ) -> FlightLog:
    """1 m/s along x towards a pole at 5 m, or `past` it; the pole is reported from a distance on."""
    k = 40
    t = np.arange(k) * 0.0625
    x = 4.9 - (t[-1] - t) + (0.25 if past else 0.0)
    sideways = steer if moved is None else moved
    seen = []
    for here in x:
        away = 4.97 - here
        near = seen_from_m is not None and away <= seen_from_m
        seen.append([Obstacle(range_m=away, azimuth_rad=0.0, elevation_rad=0.0, x_m=away, y_m=0.05, z_m=0.0, score=1.0)]
                    if near else [])
    zeros = np.zeros((k, 0), np.uint8)
    return FlightLog(
        t_us=(t * 1e6).astype(np.int64), pos_m=np.stack([x, 0 * x, 0 * x - 1.0], axis=1),
        vel_m_s=np.tile([1.0, sideways, 0.0], (k, 1)), quat=np.tile([1.0, 0.0, 0.0, 0.0], (k, 1)),
        thrust_n=np.ones((k, 4)), phase=["course"] * k, command=np.tile([1.0, steer, 0.0, 0.0], (k, 1)),
        envelope_left=zeros, envelope_right=zeros, edges_left=zeros, edges_right=zeros, obstacles=seen,
        scene={"obstacles": [POLE]})


@pytest.mark.parametrize(
    ("log", "part", "label"),
    [(flight(), "front", "never_detected"), (flight(0.4), "front", "late"),
     (flight(1.2, steer=0.3), "front", "wrong_side"), (flight(1.2, steer=-0.3), "front", "misjudged"),
     (flight(1.2, steer=-0.5, moved=0.1), "propeller", "blown_by_wind"),
     (flight(1.2, steer=-0.3, past=True), "rear", "rear_strike")],
)
def test_a_hit_gets_the_label_of_what_went_wrong(log: FlightLog, part: str, label: str) -> None:
    found = label_of("obstacle_hit", "hit obstacle 1", part, 0, log)
    assert found.name == label, found
    assert "hit obstacle 1" in found.reason and any(c.isdigit() for c in found.reason)


@pytest.mark.parametrize("outcome", ["clean", "infrastructure", "interrupted", "stuck", "timeout"])
def test_other_outcomes_are_their_own_label(outcome: str) -> None:
    assert label_of(outcome, "why", None, None, None).name == outcome


def test_without_a_log_nothing_is_made_up() -> None:
    assert label_of("estimator_failure", "why", None, None, None).name == "estimator"
    assert label_of("obstacle_hit", "why", "front", 0, None).name == "unknown"
    assert label_of("net_hit", "why", "side", None, flight()).name == "net"
    assert label_of("obstacle_hit", "why", "front", 7, flight()).name == "unknown"


def test_every_echo_of_a_flight_is_traced_to_what_made_it(tmp_path: Path) -> None:
    request = TrialRequest("poles", seed=1, denoiser="gaussian", stack="none")
    result = run_trial(request)
    assert result.outcome == "obstacle_hit" and result.label in ("never_detected", "late", "misjudged")
    assert result.path_excess == pytest.approx(1.0, abs=0.1)
    log = result.log
    assert log is not None
    found = provenance_of(log, request)
    scene = build_scene(load_scene("poles"), 1)
    struck = int(np.argmin([s.signed_distance_m(log.pos_m[-1:])[0] for s in scene.obstacles]))
    gaps_m = scene.obstacles[struck].signed_distance_m(log.pos_m)
    ahead = int(np.flatnonzero(gaps_m > 0.4)[-1])  # nearer, it leaves the beam to one side
    gap_m = float(gaps_m[ahead])
    echo = (found.t_us == log.t_us[ahead]) & (found.role == 0) & (found.obstacle == struck)
    # The first is the straight one; others have bounced off the ground on their way.
    assert echo.any() and found.path_m[echo].min() / 2.0 == pytest.approx(gap_m, abs=0.12)
    assert set(np.unique(found.obstacle)) <= {NO_OBSTACLE, GROUND, *range(6)}
    target = tmp_path / "echoes.npz"
    found.save(target)
    back = EchoProvenance.load(target)
    assert back.roles == found.roles and np.array_equal(back.amplitude_counts, found.amplitude_counts)


def test_owners_cover_every_primitive() -> None:
    from sitl.acoustics.edges import ready_edges

    scene = build_scene(load_scene("boxes"), 2)
    owners = owners_of(scene)
    assert len(owners["edge"]) == len(ready_edges(scene.primitives)) == len(scene.primitives.edges)
    assert (owners["facet"] == GROUND).sum() == 1 and set(owners["edge"]) == set(range(len(scene.obstacles)))
