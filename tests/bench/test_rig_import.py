"""`saranga-bench rig import`: logs made elsewhere become ordinary rig recordings, or one clear error."""

import hashlib
import json
import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.cli import main
from saranga.echo import COLUMN_M, EchoCycle, EchoImage
from saranga.import_log import format_names
from saranga.recording import read_recording
from saranga.sources import FileSource, open_source

RECORDINGS = Path(os.environ.get("SARANGA_RECORDINGS", Path(__file__).parents[2] / "../shared/data/echo"))
real_recordings = pytest.mark.skipif(
    not RECORDINGS.is_dir(), reason="other people's recordings are absent: set SARANGA_RECORDINGS to their folder"
)
FOP_HZ = (80_000, 76_000)
SAMPLES = 24


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    code = 0
    try:
        main([str(a) for a in arguments])
    except SystemExit as ended:
        code = int(ended.code or 0)
    out, err = capsys.readouterr()
    return code, out, err


def imported(capsys: pytest.CaptureFixture[str], path: Path, out: Path, *more: object) -> dict[str, Any]:
    code, text, err = run(capsys, "rig", "import", path, "--out", out, "--json", *more)
    assert code == 0, err
    return json.loads(text)


def played(path: Path) -> tuple[FileSource, list[EchoCycle]]:
    source = FileSource(path)
    source.open()
    cycles = []
    while not source.exhausted:
        cycles += source.poll(0.0)
    return source, cycles


def iq_of(sensor: int, row: int) -> np.ndarray:
    """(SAMPLES, 2), Q first: any pattern in which no two values are equal by accident."""
    i = 1000 * sensor + 100 * row + np.arange(SAMPLES)
    q = -2000 - i
    i[0] = q[0] = 0
    return np.stack([q, i], axis=1)


def names_line(sensor: int, odr: int) -> str:
    step_cm = 34_300 * 2 ** (7 - odr) / (2 * FOP_HZ[sensor])
    ranges = [f"{(n + 1) * step_cm:.1f}" for n in range(SAMPLES)]
    head = "# time [s],tx_id,rx_id,range [cm],intensity [a.u.],target_detected,insertionAnnotation"
    return ",".join([head, *(f"idata_{r}" for r in ranges), *(f"qdata_{r}" for r in ranges)])


def data_line(t_s: float, sensor: int, row: int) -> str:
    iq = iq_of(sensor, row)
    values = [f"{v:.1f}" for v in (*iq[:, 1], *iq[:, 0])]
    return ",".join([f"{t_s:.3f}", str(sensor), str(sensor), "41.5", "3607", "1", "0", *values])


def red_swallow_lines(rows: list[tuple[float, int, int]], sensors: int, odr: int = 4) -> list[str]:
    each = range(sensors)
    return [
        "# Chirp Microsystems redswallow Data Log",
        "# sample rate: 10.0 S/s",
        "# Decimation factor: 1",
        "# Content: iq",
        "# Sensors ID: " + ",".join(str(s) for s in each),
        "# Sensors FOP: " + ",".join(str(FOP_HZ[s]) for s in each) + " Hz",
        "# Sensors NB Samples: " + ",".join(str(SAMPLES) for _ in each),
        "# Sensors NB First samples skipped: " + ",".join("0" for _ in each),
        *(names_line(s, odr) for s in each),
        *(data_line(*row) for row in rows),
    ]


def red_swallow_config(odr: int = 4, fop_hz: int = FOP_HZ[0]) -> dict[str, Any]:
    def entry(fop: int, bar_code: str) -> dict[str, Any]:
        queues = {"current_meas": 0, "meas": [{"odr": odr}], "meas_cfg": [{"ringdown_cancel_samples": 5}]}
        return {"op_freq_hz": fop, "bandwidth": "3418.75", "otp_info_barcode": bar_code, "meas_queues": queues}

    return {
        "chsensor": {"name": "ICU-20201"},
        "sensors": {"0": entry(fop_hz, "A1"), "1": entry(FOP_HZ[1], "B2")},
        "versions": {"asicfw": "gpt-1.7.1"},
    }


def write(path: Path, lines: list[str]) -> Path:
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture
def dual(tmp_path: Path) -> Path:
    """Two sensors taking turns at 10 Hz; the second loses cycles 2 and 3, the first cycle 4."""
    rows = [(5.0 + 0.1003 * n + 0.048 * s, s, n) for n in range(8) for s in (0, 1)]
    kept = [r for r in rows if (r[1], r[2]) not in {(1, 2), (1, 3), (0, 4)}]
    (tmp_path / "air-500mm-x.json").write_text(json.dumps(red_swallow_config()))
    return write(tmp_path / "air-500mm-x.txt", red_swallow_lines(kept, 2))


def amplitudes(rows: int = 6) -> np.ndarray:
    """A hump at column 65 on something that differs from row to row."""
    hump = 8000 * np.exp(-(((np.arange(340) - 65) / 4) ** 2))
    return np.rint(hump + np.random.default_rng(1).integers(0, 400, (rows, 340))).astype(int)


def csv_lines(table: np.ndarray) -> list[str]:
    return [",".join(str(v) for v in row) for row in table]


def test_red_swallow_samples_times_and_gaps(
    dual: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    done = imported(capsys, dual, tmp_path / "x.mcap")
    assert (done["frames"], done["sensors"], done["lost"], done["fop_hz"]) == (13, 2, 3, [80_000.0, 76_000.0])
    assert done["range_per_sample_m"] == pytest.approx([343 * 4 / 80_000, 343 * 4 / 76_000])
    assert [s["odr"] for s in done["by_sensor"]] == [4, 4]
    assert [s["own_range_m"] for s in done["by_sensor"]] == pytest.approx([0.415, 0.415])
    assert done["provenance"]["source_sha256"] == hashlib.sha256(dual.read_bytes()).hexdigest()
    assert (done["provenance"]["importer"], done["provenance"]["origin"]) == ("red-swallow", "recorded")
    assert done["provenance"]["inferred"]["nominal_distance_m"].startswith("0.5 ")

    source, cycles = played(tmp_path / "x.mcap")
    assert source.hello is not None
    assert [(s.sensor, s.role, s.fop_hz, s.transmits, s.serial) for s in source.hello.sensors] == [
        (0, "left", 80_000, True, "A1"), (1, "right", 76_000, True, "B2")]
    assert source.hello.sensors[0].bandwidth_hz == 3418.75
    assert source.hello.firmware == "imported ICU-20201 gpt-1.7.1"
    assert source.counters.gaps_by_sensor == {0: 1, 1: 2}
    assert [(c.trigger, sorted(c.frames)) for c in cycles] == [
        (n, [role for s, role in enumerate(("left", "right")) if (s, n) not in {(1, 2), (1, 3), (0, 4)}])
        for n in range(8)]
    for cycle in cycles:
        for frame in cycle.frames.values():
            assert np.array_equal(frame.iq, iq_of(frame.sensor, cycle.trigger))
            assert frame.device_time_us == round((5.0 + 0.1003 * cycle.trigger + 0.048 * frame.sensor) * 1000) * 1000
            assert (frame.fop_hz, frame.odr, frame.mode) == (FOP_HZ[frame.sensor], 4, 0)
    recording = read_recording(tmp_path / "x.mcap")
    assert [t for t, _ in recording.frames()][-1] == 750_000
    assert recording.metadata["source_sha256"] == done["provenance"]["source_sha256"]


def test_red_swallow_without_configuration_takes_the_rate_from_the_column_names(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for odr in (3, 4, 5, 6):
        log = write(tmp_path / f"{odr}.txt", red_swallow_lines([(1.0, 0, 0), (1.1, 0, 0), (1.2, 0, 1)], 1, odr))
        done = imported(capsys, log, tmp_path / f"{odr}.mcap")
        assert done["by_sensor"][0]["odr"] == odr
        assert done["range_per_sample_m"] == pytest.approx(343 * 2 ** (7 - odr) / 160_000)
        assert (done["fop_hz"], done["frames"], done["repeated_frames"]) == (80_000.0, 3, [{"sensor": 0, "step": 1}])
        assert "bandwidth_hz" in done["provenance"]["assumed"]


def test_same_input_same_bytes(dual: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "b.mcap.part").write_bytes(b"left by an import that was killed")
    for name in ("a", "b"):
        imported(capsys, dual, tmp_path / f"{name}.mcap")
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()
    assert not (tmp_path / "b.mcap.part").exists()


def test_amplitudes_keep_their_rows_and_say_what_is_not_known(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = amplitudes()
    table[3] = table[4] = table[2]
    table[0, 200] = 20_500
    log = write(tmp_path / "flight.csv", csv_lines(table))
    done = imported(capsys, log, tmp_path / "f.mcap")
    assert (done["frames"], done["sensors"], done["lost"]) == (6, 1, 0)
    assert done["fop_hz"] is None
    assert done["range_per_sample_m"] is None
    assert done["repeated_frames"] == [{"sensor": 0, "step": 3}, {"sensor": 0, "step": 4}]
    assert done["before_take_off_steps"] == [0]
    assert float(done["provenance"]["assumed"]["range_per_sample_m"]) == pytest.approx(343 * 4 / 104_000, abs=1e-6)
    # 20500 is over 0.82 x 20984 = 17207, so no CORDIC made it.
    assert done["provenance"]["inferred"]["amplitude_scale"].startswith("factor 1: 20500 ")
    assert (done["by_sensor"][0]["consensus"]["sample"], done["by_sensor"][0]["consensus"]["frames"]) == (65, 3)
    _, cycles = played(tmp_path / "f.mcap")
    assert all(np.array_equal(c.frames["left"].iq, np.stack([0 * table[0], table[c.trigger]], axis=1)) for c in cycles)
    recording = read_recording(tmp_path / "f.mcap")
    assert len(list(recording.frames())) == 7
    assert json.loads(recording.metadata["repeated_frames"]) == [[0, 3], [0, 4]]
    assert recording.metadata["content"] == "amplitude"


def test_amplitudes_with_what_the_user_knows_and_repeats_as_gaps(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = amplitudes()
    table[3] = table[4] = table[2]
    log = write(tmp_path / "flight.csv", csv_lines(table))
    options = [word for pair in ("fop_hz=50000", "odr=6", "repeats=lost") for word in ("--option", pair)]
    done = imported(capsys, log, tmp_path / "f.mcap", *options)
    assert (done["frames"], done["lost"], done["repeated"], done["fop_hz"]) == (4, 2, 2, 50_000.0)
    assert done["range_per_sample_m"] == pytest.approx(343 / 50_000)
    assert [c.trigger for c in played(tmp_path / "f.mcap")[1]] == [0, 1, 2, 5]


def test_a_recording_plays_through_open_source_into_an_image(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    imported(capsys, write(tmp_path / "f.csv", csv_lines(amplitudes(3))), tmp_path / "f.mcap")
    source = open_source(f"file:{tmp_path / 'f.mcap'}")
    source.open()
    image = EchoImage()
    while not source.exhausted:
        for cycle in source.poll(1.0):
            image.push(cycle.frames["left"], 343.0)
    assert image.rows == 3
    # Column 65 of 13.19 mm is 0.857 m.
    assert np.argmax(image.envelope[-1]) * COLUMN_M == pytest.approx(65 * 343 * 4 / 104_000, abs=0.01)
    assert image.envelope[-1].max() == pytest.approx(8000 / 20_000, abs=0.03)


def edited(lines: list[str], at: int, old: str, new: str) -> list[str]:
    """Line `at` (from 1) with `old` made `new`."""
    assert old in lines[at - 1]
    return [*lines[: at - 1], lines[at - 1].replace(old, new, 1), *lines[at:]]


GOOD = red_swallow_lines([(1.0, 0, 0), (1.1, 0, 1), (1.2, 0, 2)], 1)
ROWS = csv_lines(amplitudes(3))
BROKEN: dict[str, tuple[list[str], str]] = {
    "cut in its last line": ([*GOOD[:-1], GOOD[-1][:60]], r"line 12: 1\d columns: expected 55 .* cut off here"),
    "cut in its head": (GOOD[:6], r"line 7: no line '# Sensors NB Samples: ...' before it: expected the complete head"),
    "no rows": (GOOD[:9], "line 9: no measurement after the head: expected at least one row"),
    "column missing": (edited(GOOD, 11, ",3607", ""), "line 11: 54 columns: expected 55 for 24 samples$"),
    "no number": (edited(GOOD, 11, "102.0", "1o2.0"), "line 11: column 10 is '1o2.0': expected a number of counts"),
    "not finite": (edited(GOOD, 11, "102.0", "nan"), "line 11: column 10 is 'nan': expected a number of counts"),
    "over int16": (edited(GOOD, 11, "102.0", "40000.0"), r"column 10 is '40000.0': .* in -32768..32767"),
    "time runs back": (edited(GOOD, 12, "1.200", "1.050"), "line 12: time is 1.05 s: expected more than 1.1 s"),
    "unknown sensor": (edited(GOOD, 11, "1.100,0,0", "1.100,0,7"), "line 11: rx_id is '7': expected one of 0"),
    "magnitudes": (edited(GOOD, 4, "iq", "mag"), "line 4: Content is 'mag': expected 'iq'"),
    "decimated": (edited(GOOD, 3, "1", "2"), "line 3: Decimation factor is '2': expected '1'"),
    "skipped samples": (edited(GOOD, 8, "0", "3"), "line 8: .*skipped is '3': expected a number in 0..0"),
    "sample count": (edited(GOOD, 7, "24", "30"), "line 9: 55 columns: expected 67 for 30 samples"),
    "carrier does not fit": (edited(GOOD, 6, "80000", "97000"), r"line 9: column names step by 1.7\d\d cm: expected"),
    "no carrier": (edited(GOOD, 6, "80000", "?"), r"line 6: Sensors FOP is '\?': expected a number in 20000..200000"),
    "column names": (edited(GOOD, 9, "qdata_", "idata_"), "line 9: column 32 is 'idata_1.7': expected 'qdata_'"),
    "short row": ([ROWS[0], ROWS[1].rsplit(",", 2)[0], ROWS[2]], "line 2: 338 columns: expected 340$"),
    "cut table": ([*ROWS[:2], ROWS[2][:30]], r"line 3: \d+ columns: expected 340; the log is cut off here"),
    "other width": ([r.rsplit(",", 40)[0] for r in ROWS], "line 1: 300 columns: expected 340$"),
    "text in table": (edited(ROWS, 2, ",", ",x"), r"line 2: column 2 is 'x\d+': expected a number of counts in 0\.\."),
    "negative": (edited(ROWS, 3, ",", ",-"), r"line 3: column 2 is '-\d+': expected a number of counts in 0..32767"),
    "blank cell": (edited(ROWS, 3, ROWS[2].split(",")[5], ""), "line 3: column .* is '': expected"),
    "a header": (["time,left,right", *ROWS], "line 1: 'time,left,right' opens no known format: expected one of infl"),
    "blank": (["", "  "], "is empty"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_log_is_one_clear_error(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines, expected = BROKEN[name]
    log = write(tmp_path / "log.txt", lines)
    code, out, err = run(capsys, "rig", "import", log, "--out", tmp_path / "x.mcap", "--json")
    assert code == 2
    assert json.loads(out)["exit_code"] == 2
    assert err.startswith(f"error: {log}")
    assert err.count("\n") == 1, err
    assert re.search(expected, err.rstrip("\n")), err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["log.txt"]


@pytest.mark.parametrize(
    ("edit", "expected"),
    [
        (lambda text: text[:200], r"air-500mm-x.json, line \d+: .*: expected the JSON configuration"),
        (lambda text: text.replace('"odr": 4', '"odr": 5'), "sensors.0 odr is 5: expected 4 as in the log"),
        (lambda text: text.replace("80000", "80001"), "sensors.0 op_freq_hz is 80001: expected 80000 as in the log"),
        (lambda text: text.replace("3418.75", "wide"), "sensors.0.bandwidth is 'wide': expected a number in 1..100000"),
        (lambda text: text.replace('"1": {', '"2": {'), "sensors has 0, 2, the log sensor 1"),
        (lambda text: "[]", "chsensor.name is missing"),
    ],
)
def test_a_broken_configuration_is_named(
    edit: Any, expected: str, dual: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = dual.with_suffix(".json")
    config.write_text(edit(config.read_text()))
    code, _, err = run(capsys, "rig", "import", dual, "--out", tmp_path / "x.mcap")
    assert (code, err.count("\n")) == (2, 1)
    assert re.search(expected, err), err
    assert not (tmp_path / "x.mcap").exists()


def test_wrong_kinds_of_file_and_wrong_words(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    good = write(tmp_path / "f.csv", csv_lines(amplitudes(2)))
    (tmp_path / "p.png").write_bytes(b"\x89PNG\r\n\x1a\n\0\0")
    (tmp_path / "none.txt").write_bytes(b"")
    imported(capsys, good, tmp_path / "f.mcap")
    kept = (tmp_path / "f.mcap").read_bytes()

    def error(*arguments: object) -> str:
        code, _, err = run(capsys, "rig", "import", *arguments)
        assert (code, err.count("\n")) == (2, 1), err
        return err

    out = ("--out", tmp_path / "x.mcap")
    assert "line 1: byte 0x89 is no text" in error(tmp_path / "p.png", *out)
    assert "none.txt is empty (0 bytes)" in error(tmp_path / "none.txt", *out)
    assert "does not exist" in error(tmp_path / "absent.txt", *out)
    assert "cannot be read: Is a directory" in error(tmp_path, *out)
    assert "play it with file:" in error(tmp_path / "f.mcap", *out)
    assert "f.mcap exists: recordings are never overwritten" in error(good, "--out", tmp_path / "f.mcap")
    assert (tmp_path / "f.mcap").read_bytes() == kept
    assert "cannot be created: No such file" in error(good, "--out", tmp_path / "absent" / "x.mcap")
    assert "did you mean 'red-swallow'?" in error(good, *out, "--format", "redswallow")
    assert "expected '# Chirp Microsystems redswallow Data Log'" in error(good, *out, "--format", "red-swallow")
    assert "no option 'fop' (did you mean 'fop_hz'?)" in error(good, *out, "--option", "fop=52000")
    assert "fop_hz is 52: it must be 20000..200000" in error(good, *out, "--option", "fop_hz=52")
    assert "repeats is 'drop': it must be keep or lost" in error(good, *out, "--option", "repeats=drop")
    assert "columns is 1: it must be 16..680" in error(good, *out, "--option", "columns=1")
    assert "--option 'odr': expected NAME=VALUE" in error(good, *out, "--option", "odr")
    assert format_names() == ["inflight-csv", "red-swallow"]
    assert not (tmp_path / "x.mcap").exists()


@real_recordings
@pytest.mark.parametrize(
    ("name", "frames", "repeated", "peaks"),
    [
        ("plexiglas_1m_0degrees", 36, 14, (65,)),
        ("plexiglas_1m_30degrees", 19, 12, (100,)),
        ("test_us_68_5_1mm_wall_250_polyamide", 72, 0, (193, 194, 195)),
        ("test_us_68_5_1mm_45_degrees_150_polyamide", 50, 0, tuple(range(340))),
    ],
)
def test_real_flights(
    name: str, frames: int, repeated: int, peaks: tuple[int, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = RECORDINGS / "icu30201-in-flight" / f"{name}.csv"
    done = imported(capsys, log, tmp_path / "x.mcap")
    assert (done["frames"], done["lost"], done["repeated"]) == (frames, 0, repeated)
    assert done["by_sensor"][0]["consensus"]["sample"] in peaks
    assert done["by_sensor"][0]["used_range_per_sample_m"] == pytest.approx(0.0132, abs=1e-4)
    table = np.loadtxt(log, delimiter=",")
    _, cycles = played(tmp_path / "x.mcap")
    assert np.array_equal([np.hypot(*c.frames["left"].iq.astype(float).T) for c in cycles], table)


@real_recordings
@pytest.mark.parametrize(
    ("name", "frames", "fop_hz", "odr", "nominal_m", "tolerance_m"),
    [
        ("3hz-96in-recording_SmartSonic2AM_2025-07-25_13-35-57", 30, [77_028], 4, 2.438, 0.03),
        ("air-plastic-dual-13hz-1000mm_SmartSonic2AM_2025-08-07_13-54-33", 332, [83_469, 76_877], 4, 1.0, 0.03),
        ("air-plastic-dual-13hz-500mm_SmartSonic2AM_2025-08-07_13-49-33", 377, [83_469, 76_877], 4, 0.5, 0.04),
        ("air-plastic-crd-dual-27hz-200mm_SmartSonic2AM_2025-08-07_14-35-25", 321, [83_432, 77_096], 5, 0.2, 0.03),
        ("water-plastic-45hz-110mm-closerangedefault_SmartSonic2AM_2025-08-04_13-17-29", 317, [77_220], 5, 0.11, 0.03),
    ],
)
def test_real_logs(
    name: str, frames: int, fop_hz: list[int], odr: int, nominal_m: float, tolerance_m: float, tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The peak of the mean |IQ| lies where the file's name says, late by the pulse's rise."""
    done = imported(capsys, RECORDINGS / "icu20201" / f"{name}.txt", tmp_path / "x.mcap")
    assert (done["frames"], done["lost"], done["repeated"], done["sensors"]) == (frames, 0, 0, len(fop_hz))
    assert [s["fop_hz"] for s in done["by_sensor"]] == fop_hz
    assert [s["odr"] for s in done["by_sensor"]] == [odr] * len(fop_hz)
    for sensor in done["by_sensor"]:
        assert -0.01 < sensor["consensus"]["range_m"] - nominal_m < tolerance_m
        assert sensor["peak_counts"] <= 20_985
    _, cycles = played(tmp_path / "x.mcap")
    for cycle in cycles:
        for frame in cycle.frames.values():
            assert not frame.iq[0].any()
            assert len(frame.iq) in (293, 301)
