"""A 2-D closed loop small enough to judge a policy's gains by: poles, a lagging point mass, a short-sighted sonar."""

from dataclasses import dataclass
from math import atan2, cos, hypot, pi, sin

import numpy as np

from saranga.localise import Obstacle
from saranga.navigate import Policy

TICK_S = 0.0625
POLE_RADIUS_M = 0.03
DRONE_RADIUS_M = 0.12
SENSOR_FORWARD_M = 0.08
COURSE_M = 8.0


@dataclass(frozen=True)
class ToySonar:
    """What the toy's perception gets wrong."""

    fov_rad: float = pi / 3
    reach_m: float = 1.2
    azimuth_noise_rad: float = 0.06
    range_noise_m: float = 0.01
    miss: float = 0.1
    false_rate: float = 0.02


def draw_poles(rng: np.random.Generator) -> np.ndarray:
    """5..7 poles (K, 2) as x, y, the first in the way of a straight flight, no two nearer than 0.7 m (gap 0.64 m)."""
    count = int(rng.integers(5, 8))
    poles = [(1.5, float(rng.uniform(-0.1, 0.1)))]
    while len(poles) < count:
        x, y = float(rng.uniform(1.5, COURSE_M - 0.5)), float(rng.uniform(-1.0, 1.0))
        if all(hypot(x - px, y - py) >= 0.7 for px, py in poles):
            poles.append((x, y))
    return np.array(poles)


def fly(policy: Policy, seed: int, sonar: ToySonar | None = None, speed_lag_s: float = 0.25) -> str:
    """One flight from x = 0 to COURSE_M; "clean", "hit" or "timeout"."""
    sonar = sonar or ToySonar()
    rng = np.random.default_rng(seed)
    poles = draw_poles(rng)
    policy.reset()
    x = y = vx = vy = 0.0
    steps = 25
    dt = TICK_S / steps
    for tick in range(round(40.0 / TICK_S)):
        command = policy.decide(_look(poles, x + SENSOR_FORWARD_M, y, sonar, rng), round(tick * TICK_S * 1e6))
        for _ in range(steps):
            vx += (command.vx_m_s - vx) * dt / speed_lag_s
            vy += (command.vy_m_s - vy) * dt / speed_lag_s
            x += vx * dt
            y += vy * dt
            if np.min(np.hypot(poles[:, 0] - x, poles[:, 1] - y)) < POLE_RADIUS_M + DRONE_RADIUS_M or abs(y) > 2.13:
                return "hit"
        if x > COURSE_M:
            return "clean"
    return "timeout"


def _look(poles: np.ndarray, x: float, y: float, sonar: ToySonar, rng: np.random.Generator) -> list[Obstacle]:
    seen = []
    for px, py in poles:
        r = hypot(px - x, py - y) - POLE_RADIUS_M
        azimuth = atan2(py - y, px - x)
        if abs(azimuth) > sonar.fov_rad or r > sonar.reach_m or r < 0.14 or rng.random() < sonar.miss:
            continue
        r += sonar.range_noise_m * rng.standard_normal()
        azimuth += sonar.azimuth_noise_rad * rng.standard_normal()
        seen.append(_obstacle(r, azimuth))
    if rng.random() < sonar.false_rate:
        seen.append(_obstacle(rng.uniform(0.2, 1.5), rng.uniform(-1.2, 1.2)))
    return sorted(seen, key=lambda o: o.range_m)


def _obstacle(r: float, azimuth: float) -> Obstacle:
    return Obstacle(r, azimuth, 0.0, r * cos(azimuth), r * sin(azimuth), 0.0, 1.0)
