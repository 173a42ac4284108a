"""Noise and echoes from recordings."""

from pathlib import Path

import numpy as np
import pytest
from synthesis_helpers import C_M_S, COLUMN_M, PEAK_COLUMNS, PLAIN, SIGMA_S

from saranga.errors import UsageError
from saranga.recording import FrameWriter
from saranga.synthesis import Synthesiser, load_recipe, recorded_bank
from saranga.synthesis.noise_bank import BANK_UNIT, FADE_COLUMNS
from saranga.synthesis.responses import RESPONSE_UNIT
from saranga.wire import Echo, encode

RATE_HZ = 26_500.0


def native_noise(rows: int, seed: int = 1, rms: float = 3000.0, samples: int = 256) -> np.ndarray:
    """int16 (rows, samples, 2), Q first, coloured by a moving average of three."""
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((rows, samples + 2, 2))
    x = (x[:, :-2] + x[:, 1:-1] + x[:, 2:]) / np.sqrt(3) * rms / np.sqrt(2)
    x[:, 0] = 0
    return np.rint(x).astype(np.int16)


def save(path: Path, iq: np.ndarray, **more: float) -> Path:
    np.savez(path, iq=iq, **({"fop_hz": 53_000.0, "odr": 6} | more))
    return path


def test_recorded_noise_takes_the_place_of_the_model(tmp_path):
    """Level, Rayleigh envelope and the recording's own colour, not the model's, are in the images."""
    file = save(tmp_path / "noise.npz", native_noise(400))
    recipe = load_recipe("default").with_values(PLAIN | {
        "obstacles.count_weights": [1, 0, 0, 0, 0], "noise.level_counts": [2000, 2000]})
    made = Synthesiser(recipe, 1, noise=[file])
    batch = made.batch(0, 60, iq=True)
    assert np.sqrt(np.mean(batch.images**2)) == pytest.approx(0.1, rel=0.02)
    assert batch.images.mean() / np.sqrt(np.mean(batch.images**2)) == pytest.approx(0.886, abs=0.005)
    lag = 2 * COLUMN_M / C_M_S * RATE_HZ
    for columns in (round(1 / lag), round(2 / lag)):
        # a moving average of three has a triangular autocorrelation: 2/3 and 1/3 at one and two samples
        got = np.mean(batch.iq[..., columns:] * batch.iq[..., :-columns].conj()) / np.mean(np.abs(batch.iq) ** 2)
        assert got.real == pytest.approx(1 - columns * lag / 3, abs=0.03)
    assert made.provenance()["noise"] == [str(file)]


def test_bank_rows_are_seamless_and_of_unit_power(tmp_path):
    bank = recorded_bank([save(tmp_path / "a.npz", native_noise(100)),
                          save(tmp_path / "b.npz", native_noise(50, 2, 500.0))], C_M_S)
    rows = BANK_UNIT * (bank.re + 1j * bank.im)
    assert list(bank.starts) == [0, 100, 150] and not bank.banded and rows.shape[1] <= 512 - FADE_COLUMNS
    for first, last in ((0, 100), (100, 150)):
        assert np.mean(np.abs(rows[first:last]) ** 2) == pytest.approx(1.0, abs=1e-3)
    around = np.abs(rows[:, 0] - rows[:, -1])
    assert around.mean() == pytest.approx(np.abs(np.diff(rows, axis=1)).mean(), rel=0.15)


def test_rig_recordings_give_their_receive_only_cycles(tmp_path):
    iq = native_noise(20)
    with FrameWriter(tmp_path / "rig.mcap") as writer:
        for n, row in enumerate(iq):
            for mode in (0, 1):
                echo = Echo(sensor=0, sequence=2 * n + mode, trigger=n, device_time_us=25_600 * n, fop_hz=53_000.0,
                            odr=6, mode=mode, iq=row if mode else row[::-1].copy())
                writer.write(encode(echo), 25_600 * n)
    from_rig = recorded_bank([tmp_path / "rig.mcap"], C_M_S)
    from_array = recorded_bank([save(tmp_path / "rig.npz", iq)], C_M_S)
    assert from_rig.re.tobytes() == from_array.re.tobytes() and len(from_rig.re) == 20


def test_a_recorded_echo_becomes_a_response_with_its_leading_edge_at_zero(tmp_path):
    """A known pulse at a known range, turned by a slow drift and with noise: R is that pulse from 0 on."""
    tau = 2 * 1.0137 / C_M_S
    t = np.arange(256) / RATE_HZ
    rng = np.random.default_rng(2)
    rows = []
    for k in range(40):
        x = 8000 * np.exp(-0.5 * ((t - tau - 2.5 * SIGMA_S) / SIGMA_S) ** 2) * np.exp(1j * (1 + 0.05 * k))
        x = x + 40 * (rng.standard_normal(256) + 1j * rng.standard_normal(256))
        rows.append(np.rint(np.stack([x.imag, x.real], axis=1)).astype(np.int16))
    file = save(tmp_path / "pole.npz", np.array(rows))
    responses = [{"name": "mine", "file": str(file)}]
    made = Synthesiser(load_recipe("default").with_values(PLAIN | {"echo.responses": responses}), 1)
    r = made.responses
    columns = np.arange(r.re.shape[2]) - r.lead
    size = np.hypot(r.re[0, 0], r.im[0, 0]) * RESPONSE_UNIT
    sigma = SIGMA_S * C_M_S / (2 * COLUMN_M)
    assert np.abs(size - np.exp(-0.5 * ((columns - PEAK_COLUMNS) / sigma) ** 2)).max() < 0.03
    assert abs(np.angle(complex(r.re[0, 0, size.argmax()], r.im[0, 0, size.argmax()]))) < 0.05
    batch = made.batch(0, 20)
    peaks = np.argmax(batch.images[:, 0, -1], axis=1)
    assert np.abs(peaks - batch.truth["path_m"][:, 0, 0] / (2 * COLUMN_M) - PEAK_COLUMNS).max() < 1.0


@pytest.mark.parametrize(("arrays", "words"), [
    ({"iq": np.zeros((20, 256, 2), np.int16), "fop_hz": 53e3, "odr": 6}, "0 rows of 0 columns"),
    ({"iq": native_noise(3), "fop_hz": 53e3, "odr": 6}, "3 rows of"),
    ({"iq": native_noise(20)}, "needs fop_hz and odr"),
    ({"iq": np.zeros((20, 300), np.complex64)}, r"shape \(20, 300\)"),
    ({"iq": np.full((20, 512), np.nan, np.complex64)}, "20 of 20 rows have values that are not finite"),
    ({"amplitude": np.zeros((20, 512))}, "no array 'iq'"),
    ({"iq": np.zeros((20, 512))}, "float64"),
])
def test_bad_recordings_are_named(tmp_path, arrays, words):
    np.savez(tmp_path / "bad.npz", **arrays)
    with pytest.raises(UsageError, match=words) as caught:
        recorded_bank([tmp_path / "bad.npz"], C_M_S)
    assert "bad.npz" in str(caught.value) and "\n" not in str(caught.value)


def test_files_that_are_none(tmp_path):
    (tmp_path / "text.npz").write_text("hello")
    for path, words in ((tmp_path / "text.npz", "not a readable"), (tmp_path / "none.npz", "does not exist")):
        with pytest.raises(UsageError, match=words):
            recorded_bank([path], C_M_S)
    silent = np.zeros((10, 256, 2), np.int16)
    silent[:, 5] = 1
    save(tmp_path / "flat.npz", native_noise(10, rms=100.0))
    with pytest.raises(UsageError, match="no echo stands out"):
        Synthesiser(load_recipe("default").with_values(
            {"echo.responses": [{"name": "x", "file": str(tmp_path / "flat.npz")}]}), 1)
