"""`saranga.evaluation` on recordings: longer than the network's record, without phase, damaged, and real ones."""

import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from saranga.denoise import load_denoiser
from saranga.echo import EchoFrame, EchoImage, resample
from saranga.errors import UsageError
from saranga.evaluation.long_image import LongImage, images, long_plan, stitched_row, window_starts
from saranga.evaluation.on_recording import consensus, score_recording
from saranga.evaluation.recorded import RecordedFrames, read_recorded
from saranga.recording import FrameWriter
from saranga.resample import COLUMN_M, resample_into
from saranga.wire import FLAG_BOOT, Echo, Hello, SensorInfo, encode

C_M_S = 343.0
FOP_HZ, ODR, SAMPLES = 52_000.0, 5, 340
STEP_M = C_M_S / (2 * FOP_HZ / 4)
SIGMA_M = 0.0115
PEAK_M = 2.5 * SIGMA_M
RECORDINGS = Path(os.environ.get("SARANGA_RECORDINGS", Path(__file__).parents[2] / "../shared/data/echo"))
real_recordings = pytest.mark.skipif(
    not RECORDINGS.is_dir(), reason="other people's recordings are absent: set SARANGA_RECORDINGS to their folder"
)


def records(count: int, range_m: float | None, amplitude: float = 5.0, seed: int = 1, noise: float = 1000.0,
            silent: int = 0) -> np.ndarray:
    """(count, SAMPLES, 2) int16, Q first: an echo of `amplitude` noise RMS whose leading edge is at `range_m`."""
    rng = np.random.default_rng(seed)
    iq = rng.standard_normal((count, SAMPLES)) + 1j * rng.standard_normal((count, SAMPLES))
    iq /= np.sqrt(2)
    if range_m is not None:
        iq += amplitude * np.exp(-0.5 * ((np.arange(SAMPLES) * STEP_M - range_m - PEAK_M) / SIGMA_M) ** 2)
    iq[:, :silent] *= 0.05
    iq[:, 0] = 0
    return np.rint(noise * np.stack([iq.imag, iq.real], axis=-1)).astype(np.int16)


def write(path: Path, iq: np.ndarray, triggers: list[int] | None = None, mode: int = 0,
          metadata: dict[str, str] | None = None, odr: int = ODR) -> Path:
    sensor = SensorInfo(sensor=0, role="left", fop_hz=FOP_HZ, bandwidth_hz=3980.0, transmits=True)
    with FrameWriter(path, metadata) as writer:
        writer.write(encode(Hello(firmware="test", sensors=(sensor,), flags=FLAG_BOOT)), 0)
        for k, frame in zip(triggers or range(len(iq)), iq, strict=True):
            writer.write(encode(Echo(sensor=0, sequence=k, trigger=k, device_time_us=k * 65_000, fop_hz=FOP_HZ, odr=odr,
                                     mode=mode, iq=frame)), k * 65_000)
    return path


@pytest.fixture
def made(tmp_path: Path) -> Callable[..., RecordedFrames]:
    def make(iq: np.ndarray, **options: object) -> RecordedFrames:
        return read_recorded(write(tmp_path / f"{len(list(tmp_path.iterdir()))}.mcap", iq, **options))  # type: ignore[arg-type]

    return make


def test_the_long_grid_goes_on_where_the_short_one_ends() -> None:
    """Its first 512 columns are `resample`'s; further out an echo is still at its range."""
    iq = records(1, 2.8, 30.0)[0]
    frame = EchoFrame("left", 0, 0, 0, 0, FOP_HZ, ODR, 0, iq)
    row = np.zeros(1380, np.complex64)
    resample_into(iq, long_plan(STEP_M, SAMPLES, 1380), 1 / 20_000, row)
    assert np.allclose(row[:512], resample(frame, C_M_S), atol=1e-6)
    assert np.argmax(np.abs(row)) * COLUMN_M == pytest.approx(2.8 + PEAK_M, abs=0.006)
    assert np.abs(row).max() == pytest.approx(1.5, rel=0.1)


@pytest.mark.parametrize("columns", [512, 513, 700, 768, 1380, 1605])
def test_windows_cover_every_column_and_stitch_without_a_seam(columns: int) -> None:
    starts = window_starts(columns)
    assert starts[0] == 0 and starts[-1] == columns - 512 and max(np.diff([*starts, starts[-1]])) <= 256
    assert (columns == 512) == (len(starts) == 1)
    iq = np.zeros((32, columns), np.complex64)
    iq[-1] = np.arange(columns)
    took: list[tuple[int, int]] = []

    class Repeats:
        """The window itself; the outer fifth is rubbish wherever another window has that column further inside."""

        name, threshold, edge_offset_m = "repeats", 0.5, 0.0

        def __call__(self, image: EchoImage) -> np.ndarray:
            row = image.envelope[-1].copy()
            took.append((int(row[0]), int(row[-1])))
            if row[0] > 0:
                row[:100] = -1
            if row[-1] < columns - 1:
                row[-100:] = -1
            return row

    row, seconds = stitched_row(Repeats(), Repeats(), LongImage(iq, 32, 0))
    assert np.array_equal(row, np.arange(columns)) and seconds > 0
    assert [first for first, _ in took] == starts


@pytest.mark.parametrize("range_m", [0.6, 1.65, 3.9])
def test_an_echo_is_found_anywhere_in_a_long_record(made: Callable[..., RecordedFrames], range_m: float) -> None:
    recorded = made(records(20, range_m, 6.0))
    denoisers = {name: load_denoiser(name) for name in ("gaussian", "tbd")}
    scores = score_recording(denoisers, recorded, range_m, 0.05, C_M_S)
    for score in scores.values():
        assert score.frames == 20 and score.hit_rate >= 0.9 and score.hit_rate_clear >= 0.9
        assert score.median_error_m < 0.01
        assert score.false_alarms_per_window == pytest.approx(score.false_alarms_per_frame * 512 / 1384, rel=0.01)
    assert scores["tbd"].false_alarms_per_frame < 0.3
    agreed = consensus(recorded, C_M_S)
    assert agreed.range_m == pytest.approx(range_m + PEAK_M, abs=0.01)
    assert agreed.peak_over_noise_db == pytest.approx(20 * np.log10(6.0), abs=0.7)


def test_columns_m_takes_the_place_of_carrier_and_speed_of_sound(made: Callable[..., RecordedFrames]) -> None:
    recorded = made(records(8, 1.0, 8.0))
    assert consensus(recorded, C_M_S, 2 * STEP_M).range_m == pytest.approx(2 * (1.0 + PEAK_M), abs=0.02)


def test_noise_of_amplitudes_raises_no_more_edges_than_complex_noise(made: Callable[..., RecordedFrames]) -> None:
    """Of single cycles and of means of five, which scatter less; a faint wall in such means is still found."""
    iq = records(200, None, seed=5)
    echo = records(200, 1.3, 2.0, seed=6)
    tbd = {"tbd": load_denoiser("tbd")}
    score = {}
    for name, part in (("noise", iq), ("wall", echo)):
        for cycles in (1, 5):
            mean = np.hypot(*part.astype(float).transpose(2, 0, 1)).reshape(200 // cycles, cycles, -1).mean(axis=1)
            flat = np.stack([0 * mean, np.rint(mean)], axis=-1).astype(np.int16)[:40]
            recorded = made(flat, metadata={"content": "amplitude"})
            assert recorded.amplitude_only
            score[name, cycles] = score_recording(tbd, recorded, 1.3 + PEAK_M, 0.1, C_M_S)["tbd"]
    assert score["noise", 1].false_alarms_per_window < 0.15
    assert score["noise", 5].false_alarms_per_window < 0.15
    assert score["wall", 5].hit_rate > 0.8


def test_what_the_sensor_cancels_is_not_evaluated(made: Callable[..., RecordedFrames]) -> None:
    """Amplitudes, means of five, as the in-flight logs; 20 nearly empty samples: the step behind them is no obstacle,
    and no consensus."""
    five = np.hypot(*records(60, 1.2, 4.0, silent=21).astype(float).transpose(2, 0, 1)).reshape(12, 5, -1).mean(axis=1)
    iq = np.stack([0 * five, np.rint(five)], axis=-1).astype(np.int16)
    recorded = made(iq, metadata={"content": "amplitude"})
    agreed = consensus(recorded, C_M_S)
    assert agreed.ring_down_m == pytest.approx(22 * STEP_M, abs=STEP_M)
    assert agreed.range_m == pytest.approx(1.2 + PEAK_M, abs=0.02)
    gaussian = {"gaussian": load_denoiser("gaussian")}
    blind, seeing = (score_recording(gaussian, recorded, 1.2, 0.05, C_M_S, None, limit)["gaussian"]
                     for limit in (agreed.ring_down_m, 0.135))
    assert blind.false_alarms_per_frame < 0.3 < 0.9 < seeing.false_alarms_per_frame
    assert consensus(made(records(12, 1.2)), C_M_S).ring_down_m == 0.135


def test_repeated_first_and_lost_frames(made: Callable[..., RecordedFrames]) -> None:
    """Of triggers 0 1 2 3 6 7: 0 is before take-off, 2 repeats 1, 4 and 5 are lost: rows 1 3 - - 6 7."""
    iq = records(6, 1.0)
    recorded = made(iq, triggers=[0, 1, 2, 3, 6, 7], metadata={
        "before_take_off_steps": "[0]", "repeated_frames": "[[0, 2], [9, 3]]"})
    assert (recorded.repeated, recorded.before_take_off, recorded.lost["frames_missing"]) == (1, 1, 2)
    assert recorded.losses == "2 frames missing"
    seen = [(i.trigger, i.rows, i.iq.copy()) for i in images(recorded, C_M_S)]
    assert [(trigger, rows) for trigger, rows, _ in seen] == [(1, 1), (3, 2), (6, 5), (7, 6)]
    last = np.abs(seen[-1][2])
    assert [bool(row.any()) for row in last[-7:]] == [False, True, True, False, False, True, True]
    assert np.array_equal(seen[0][2][-1], seen[-1][2][-6]) and np.array_equal(seen[1][2][-1], seen[-1][2][-5])


def test_damaged_recordings_keep_what_is_readable(tmp_path: Path) -> None:
    whole = write(tmp_path / "whole.mcap", records(120, 1.0)).read_bytes()
    for name, data, least in (("cut", whole[:len(whole) * 2 // 3], 60),
                              ("broken", whole[:len(whole) // 2] + b"\xff" * 64 + whole[len(whole) // 2 + 64:], 20)):
        path = tmp_path / f"{name}.mcap"
        path.write_bytes(data)
        recorded = read_recorded(path)
        assert least <= len(recorded.frames) < 120 and not recorded.complete
        if name == "cut":
            assert "cut off" in recorded.losses
        else:
            assert recorded.lost["frames_after_the_break"] == 120 - len(recorded.frames)
        scores = score_recording({"gaussian": load_denoiser("gaussian")}, recorded, 1.0, 0.05, C_M_S)
        assert scores["gaussian"].frames == len(recorded.frames) and scores["gaussian"].hit_rate > 0.8


def test_recordings_that_cannot_be_evaluated(tmp_path: Path) -> None:
    good = write(tmp_path / "good.mcap", records(3, 1.0))
    (tmp_path / "log.csv").write_text("1,2,3\n")
    (tmp_path / "stub.mcap").write_bytes(good.read_bytes()[:40])
    marked = write(tmp_path / "m.mcap", records(2, 1.0), metadata={"repeated_frames": "what"})
    for path, role, words in (
        (tmp_path / "log.csv", None, "log.csv, line 1.*opens no known format|log.csv"),
        (tmp_path / "absent.mcap", None, "does not exist"),
        (tmp_path, None, "is a folder"),
        (tmp_path / "stub.mcap", None, "empty or cut off at its start"),
        (good, "right", "no frame of a sensor 'right' in it: it has left"),
        (write(tmp_path / "n.mcap", records(3, None), mode=1), None, "all 3 frames of sensor 'left' are receive-only"),
        (write(tmp_path / "r.mcap", records(2, 1.0), metadata={"before_take_off_steps": "[0, 1]"}), None,
         "all 2 frames of sensor 'left' are repeated or from before take-off"),
        (marked, None, "metadata 'repeated_frames' is 'what'"),
    ):
        with pytest.raises(UsageError, match=words):
            read_recorded(path, role)
    recorded, gaussian = read_recorded(good), {"gaussian": load_denoiser("gaussian")}
    for truth_m, tolerance_m, step_m, words in (
        (4.6, 0.1, None, r"--truth-m 4.6 m is outside the record of .*, 0 to 4.47 m"),
        (float("nan"), 0.1, None, "--truth-m nan m is outside"),
        (1.0, 0.0, None, "--tolerance-m 0 m: it must be over 0"),
        (1.0, 0.1, 0.2, r"records would reach 67.8 m \(limit 30 m\): check --columns-m"),
    ):
        with pytest.raises(UsageError, match=words):
            score_recording(gaussian, recorded, truth_m, tolerance_m, C_M_S, step_m)


@real_recordings
@pytest.mark.parametrize(
    ("name", "range_m", "frames", "tbd_hits"),
    [("test_us_68_5_1mm_wall_250_polyamide", 2.546, 71, 0.88), ("plexiglas_1m_0degrees", 0.857, 21, 0.85),
     ("plexiglas_1m_30degrees", 1.319, 6, 0.8), ("test_us_68_5_1mm_45_degrees_150_polyamide", None, 49, None)],
)
def test_real_flights(name: str, range_m: float | None, frames: int, tbd_hits: float | None, tmp_path: Path) -> None:
    """Within 10 cm of the peak of the file's own mean, worked out from the CSV by hand: columns 193, 65 and 100."""
    from saranga.import_log import import_log

    import_log(RECORDINGS / "icu30201-in-flight" / f"{name}.csv", tmp_path / "x.mcap")
    recorded = read_recorded(tmp_path / "x.mcap")
    assert json.loads(recorded.metadata["before_take_off_steps"]) == [0]
    agreed = consensus(recorded, C_M_S)
    assert agreed.ring_down_m == pytest.approx(0.27, abs=0.02)
    tbd = score_recording({"tbd": load_denoiser("tbd")}, recorded, range_m or 1.5, 0.1, C_M_S, None,
                          agreed.ring_down_m)["tbd"]
    assert tbd.frames == agreed.frames == frames
    if range_m is None:
        # Nothing stands out of the noise: 0.022 false edges in each of three windows are expected, 3 in 49 frames,
        # and more than 7 in one file of a hundred.
        assert abs(agreed.peak_over_noise_db) < 1.0 and tbd.hits == 0 and tbd.false_alarms_per_frame <= 7 / 49
    else:
        assert agreed.range_m == pytest.approx(range_m, abs=0.014) and tbd.hit_rate >= (tbd_hits or 0)
