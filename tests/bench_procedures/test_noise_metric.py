"""RMS of receive-only records, clipping, background and settling against numbers worked out by other means."""

import math

import numpy as np
import pytest

from bench.procedures.background import without_background
from bench.procedures.noise_metric import (
    CoherenceMeter,
    NoiseMeter,
    clipping_bias_db,
    unclipped_rms_counts,
)
from bench.procedures.settling import Settling, slope_of
from saranga.echo import EchoFrame
from saranga.errors import UsageError


def frame(iq: np.ndarray, mode: int = 1, role: str = "left") -> EchoFrame:
    """I + jQ in counts as the sensor sends it."""
    pairs = np.stack([iq.imag, iq.real], axis=1)
    return EchoFrame(role, 0, 0, 0, 0, 53_000.0, 6, mode, np.rint(pairs).astype(np.int16))


def noise(rms: float, samples: int, seed: int = 1, clip: bool = False) -> np.ndarray:
    rng = np.random.default_rng(seed)
    iq = (rng.standard_normal(samples) + 1j * rng.standard_normal(samples)) * rms / math.sqrt(2.0)
    size = np.abs(iq)
    return np.where(size > 20_984.0, iq * 20_984.0 / size, iq) if clip else iq


def test_rms_of_known_noise_is_found_without_its_ring_down() -> None:
    meter = NoiseMeter(skip_samples=20)
    for k in range(100):
        iq = noise(2_000.0, 256, seed=k)
        iq[:20] = 15_000.0
        meter.add(frame(iq))
    reading = meter.reading()
    assert reading.rms * 20_000 == pytest.approx(2_000.0, rel=0.02)
    assert (reading.frames, reading.n, reading.clipped_share) == (100, 100 * 236, 0.0)
    assert sum(reading.spectrum) == pytest.approx(1.0)


@pytest.mark.parametrize(("rms", "bias_db"), [(10_000.0, -0.06), (12_000.0, -0.21), (15_000.0, -0.66)])
def test_clipping_takes_what_the_fact_sheet_says_and_is_taken_back(rms: float, bias_db: float) -> None:
    assert clipping_bias_db(rms) == pytest.approx(bias_db, abs=0.012)
    meter = NoiseMeter(skip_samples=1)
    for k in range(200):
        meter.add(frame(noise(rms, 256, seed=k, clip=True)))
    reading = meter.reading()
    assert 20 * math.log10(reading.raw_rms * 20_000 / rms) == pytest.approx(bias_db, abs=0.06)
    assert reading.rms * 20_000 == pytest.approx(rms, rel=0.01)
    assert not reading.lower_bound


def test_a_sensor_that_mostly_clips_gives_only_a_lower_bound() -> None:
    meter = NoiseMeter(skip_samples=1)
    for k in range(50):
        meter.add(frame(noise(30_000.0, 256, seed=k, clip=True)))
    reading = meter.reading()
    assert reading.lower_bound
    assert reading.rms == reading.raw_rms
    assert reading.clipped_share > 0.5
    assert unclipped_rms_counts(20_984.0) == math.inf


def test_records_made_while_transmitting_are_refused() -> None:
    with pytest.raises(UsageError, match="receive-only"):
        NoiseMeter().add(frame(noise(100.0, 64), mode=0))
    with pytest.raises(UsageError, match="ring-down"):
        NoiseMeter(skip_samples=64).add(frame(noise(100.0, 64)))
    with pytest.raises(UsageError, match="no noise record"):
        NoiseMeter().reading()


def test_coherence_tells_common_sound_from_separate_noise() -> None:
    alone, common = CoherenceMeter(1), CoherenceMeter(1)
    for k in range(60):
        one, other, shared = noise(1_000.0, 256, 3 * k), noise(1_000.0, 256, 3 * k + 1), noise(3_000.0, 256, 3 * k + 2)
        alone.add(frame(one), frame(other, role="right"))
        common.add(frame(one + shared), frame(other + shared, role="right"))
    assert alone.value() < 0.02
    assert common.value() == pytest.approx(0.81, abs=0.03)  # (9 / 10)^2


@pytest.mark.parametrize(("margin_db", "treatment"), [(20.0, "clear"), (15.1, "clear"), (14.9, "subtracted"),
                                                     (6.1, "subtracted"), (5.9, "upper_bound"), (0.0, "upper_bound")])
def test_background_is_taken_off_by_its_margin(margin_db: float, treatment: str) -> None:
    background = 0.01
    rms = background * 10 ** (margin_db / 20)
    level = without_background(rms, background)
    assert level.treatment == treatment
    assert level.margin_db == pytest.approx(margin_db)
    assert level.rms == pytest.approx(math.sqrt(rms**2 - background**2) if treatment == "subtracted" else rms)
    with pytest.raises(ValueError, match="finite"):
        without_background(math.nan, 0.1)


def test_settling_waits_for_the_slope_and_gives_up_in_time() -> None:
    rng = np.random.default_rng(3)
    watch = Settling(least_s=0.5, most_s=10.0, window_s=1.0, per_second=0.02, floor=0.01)
    found = None
    for k in range(1, 500):
        t = k / 50
        watch.add(t, 2.0 * (1 - math.exp(-t / 0.8)) + 0.004 * rng.standard_normal())
        if watch.settled(t):
            found = t
            break
    # The slope of 2 (1 - e^(-t/0.8)) over a second falls under 2 % of 2 N/s at about 3.6 s.
    assert found is not None
    assert 3.0 < found < 5.5
    ramp = Settling(least_s=0.5, most_s=3.0)
    for k in range(1, 150):
        ramp.add(k / 50, 0.2 * k / 50)
        assert not ramp.settled(k / 50)
    assert ramp.given_up(3.0)
    assert math.isnan(slope_of([0.0, 1.0, 2.0], [math.nan, 1.0, 2.0]).slope)
