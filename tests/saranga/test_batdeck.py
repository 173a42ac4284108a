"""BatDeck against the figures of its behaviour: speed and yaw by distance, learnt threshold, flips by seed."""

import numpy as np
import pytest

from saranga.denoise import load_denoiser
from saranga.echo import COLUMN_M, FULL_SCALE, EchoCycle, EchoFrame, EchoImage, load_sonar
from saranga.errors import UsageError
from saranga.navigate import EchoPolicy, VelocityCommand, load_policy, sonar_of
from saranga.navigate.batdeck import BatDeck, BatDeckParameters
from saranga.stack import Stack

HOVER_COUNTS = 600.0
TICK_US = 62_500


class Rows(EchoImage):
    """An image whose newest rows are written directly, in counts."""

    def __init__(self) -> None:
        super().__init__()
        self._next = 0

    def add(self, row: np.ndarray) -> None:
        slot = self._advance()
        self._iq[slot] = row / FULL_SCALE
        self._iq[slot + self._m] = self._iq[slot]
        self._trigger = self._next
        self._next += 1


class Bench:
    """Echo rows at a chosen distance, 2.44 cycles a tick as in flight, into a BatDeck that has hovered."""

    def __init__(self, **parameters: float) -> None:
        self.policy = BatDeck(BatDeckParameters(**parameters))  # type: ignore[arg-type]
        self.image = Rows()
        self.t_us = 0
        for _ in range(25):
            self.tick(None)
        self.policy.reset()

    def tick(self, distance_m: float | None, counts: float = 8000.0) -> VelocityCommand:
        for _ in range(2):
            row = np.full(512, HOVER_COUNTS)
            if distance_m is not None:
                row[round(distance_m / COLUMN_M):] = counts
            self.image.add(row)
        self.t_us += TICK_US
        return self.policy.decide_echoes({"left": self.image}, self.t_us)

    def settle(self, distance_m: float | None, ticks: int = 60) -> VelocityCommand:
        for _ in range(ticks):
            command = self.tick(distance_m)
        return command


@pytest.mark.parametrize(("d", "vx", "yaw"), [
    (1.2, 0.30, 0.0), (0.8, 0.20, 0.0), (0.6, 0.15, 0.75), (0.5, 0.125, 1.125), (0.4, 0.10, 1.5), (0.32, 0.08, 1.5),
    (0.28, 0.0, 1.5), (None, 0.415, 0.0)])
def test_speed_and_yaw_follow_the_distance(d: float | None, vx: float, yaw: float) -> None:
    command = Bench().settle(d)
    assert command.vx_m_s == pytest.approx(vx, abs=0.002)
    assert command.yaw_rate_rad_s == pytest.approx(yaw, abs=0.02)
    assert command.vy_m_s == command.vz_m_s == 0.0


def test_speed_rises_slowly_and_falls_at_once() -> None:
    bench = Bench(nothing_m=5.0)
    speeds = [bench.tick(None).vx_m_s for _ in range(30)]
    assert np.allclose(np.diff(speeds[:19]), 0.05) and speeds[-1] == 1.0
    assert bench.tick(0.28, counts=20_000.0).vx_m_s == 0.0
    assert Bench(desired_speed_m_s=0.5, nothing_m=5.0).settle(None).vx_m_s == 0.5
    assert Bench(desired_speed_m_s=2.0, nothing_m=5.0).settle(None).vx_m_s == 1.0


def test_threshold_is_learnt_in_hover() -> None:
    bench = Bench()
    assert bench.policy.threshold_counts == pytest.approx(np.full(512, 1.5 * HOVER_COUNTS + 1500.0))
    bench.settle(None)
    for counts, seen in ((2390.0, False), (2410.0, True)):
        for _ in range(60):
            bench.tick(0.6, counts)
        assert (bench.policy.distance_m < 1.0) is seen


def test_the_filter_needs_repeated_echoes() -> None:
    bench = Bench()
    bench.settle(None)
    # One cycle of 8 000 in 600 raises the filter to 2 080 of a threshold of 2 400; two to 3 264.
    bench.image.add(np.full(512, 8000.0))
    bench.policy.decide_echoes({"left": bench.image}, bench.t_us)
    assert bench.policy.distance_m > 1.0
    bench.image.add(np.full(512, 8000.0))
    bench.policy.decide_echoes({"left": bench.image}, bench.t_us)
    assert bench.policy.distance_m < 0.2


def test_without_hover_it_hovers_until_it_has_learnt() -> None:
    policy, image = BatDeck(BatDeckParameters()), Rows()
    speeds = []
    for k in range(45):
        image.add(np.full(512, HOVER_COUNTS))
        speeds.append(policy.decide_echoes({"left": image}, k * 25_600).vx_m_s)
    assert speeds[:39] == [0.0] * 39 and speeds[39] == pytest.approx(0.05)


def sides(seed: int, distance_m: float | None, seconds: float = 200.0) -> list[float]:
    bench = Bench(seed=seed)
    found = []
    for k in range(round(seconds * 16)):
        bench.tick(distance_m)
        if k % 16 == 15:
            found.append(bench.policy._side)
    return found


def test_side_flips_by_chance_every_ten_seconds_and_by_seed() -> None:
    one = sides(1, None)
    assert one == sides(1, None) and one != sides(2, None)
    assert one[:10] == [1.0] * 10
    changes = [k for k in range(1, len(one)) if one[k] != one[k - 1]]
    assert 3 <= len(changes) <= 16 and min(np.diff(changes)) >= 9
    # As near as 0.4 m the side is kept.
    assert set(sides(1, 0.35, 60.0)) == {1.0}


def test_the_stack_gives_it_echoes_of_one_sensor() -> None:
    geometry = load_sonar(sonar_of("batdeck"))
    assert geometry.roles == ("left",) and sonar_of("saranga") == "pair"
    policy = load_policy("batdeck", desired_speed_m_s=1.0)
    assert isinstance(policy, EchoPolicy) and not isinstance(load_policy("saranga"), EchoPolicy)

    class Never:
        threshold, edge_offset_m, name = 0.5, 0.0, "never"

        def __call__(self, image: EchoImage) -> np.ndarray:
            raise AssertionError("no denoiser may run")

    stack = Stack(Never(), policy, geometry)  # type: ignore[arg-type]
    stack.warm_up()
    rng = np.random.default_rng(0)
    for k in range(60):
        iq = rng.normal(0.0, 400.0, (256, 2)).astype(np.int16)
        frame = EchoFrame("left", 0, k, k, k * 25_600, geometry.fop_hz, geometry.odr, 0, iq)
        decision = stack.step([EchoCycle(k, k * 25_600, {"left": frame})], k * 25_600)
    assert decision.fault is None and decision.command.vx_m_s > 0.3 and not decision.edges


def test_a_policy_that_needs_azimuth_refuses_one_sensor() -> None:
    with pytest.raises(UsageError, match=r"'saranga' needs two sensors.*batdeck"):
        Stack(load_denoiser("gaussian"), load_policy("saranga"), load_sonar("batdeck"))


def test_horn_is_45_degrees_wide() -> None:
    from scipy.special import j1

    geometry = load_sonar("batdeck")
    v = 2 * np.pi * 53_000 / 343.0 * geometry.a_h_m * np.sin(np.radians(22.5))
    assert 20 * np.log10(2 * j1(v) / v) == pytest.approx(-3.0, abs=0.05)
    assert geometry.a_h_m == geometry.a_v_m


@pytest.mark.parametrize("bad", [{"seed": -1}, {"full_yaw_rad_s": float("nan")}, {"calibration_cycles": 0}])
def test_bad_parameters_are_refused(bad: dict[str, float]) -> None:
    with pytest.raises(UsageError, match=next(iter(bad))):
        load_policy("batdeck", **bad)
