"""Amplitudes logged in flight: CSV without header, a row a measurement, a column a sample, no clock, no counter.

Each row is the mean of five cycles of an ICU-30201 and the first was taken before take-off (README of the recordings
this was written for). The file says neither carrier nor rate nor which amplitude it holds.
"""

from pathlib import Path

import numpy as np

from saranga.importers.log import (
    FULL_SCALE_COUNTS,
    ON_CHIP_FACTOR,
    SOUND_SPEED_M_S,
    ImportedLog,
    LoggedFrame,
    Reader,
    SensorLog,
    check_columns,
    counts,
    is_number,
    read_lines,
    repeated_rows,
)
from saranga.messages import MAX_SAMPLES, SensorInfo
from saranga.resample import iq_rate_hz

NAME = "inflight-csv"
LOOKS = "340 amplitudes a line, separated by commas, no header"
COLUMNS = 340
FOP_HZ = 52_000.0
ODR = 5
BANDWIDTH_HZ = 3_980.0
RING_DOWN_SAMPLES = 20
CYCLES_A_ROW = 5


def recognises(first_line: str) -> bool:
    """Nothing but numbers between commas."""
    fields = first_line.split(",")
    return len(fields) >= 16 and all(is_number(text) for text in fields)


def build(
    fop_hz: float | None = None, odr: int | None = None, columns: int = COLUMNS, repeats: str = "keep"
) -> Reader:
    """A reader of such files.

    Args:
        fop_hz: carrier, where the user knows it [52000].
        odr: output data rate setting, where the user knows it [5, fop/4].
        columns: samples a row.
        repeats: "keep" rows equal to the row before, or count them as "lost".

    Raises:
        ValueError: a value out of its limits.
    """
    if fop_hz is not None and not (isinstance(fop_hz, int | float) and 20e3 <= fop_hz <= 200e3):
        raise ValueError(f"fop_hz is {fop_hz!r}: it must be 20000..200000")
    if odr is not None and odr not in (2, 3, 4, 5, 6):
        raise ValueError(f"odr is {odr!r}: it must be 2..6")
    if not isinstance(columns, int) or not 16 <= columns <= MAX_SAMPLES:
        raise ValueError(f"columns is {columns!r}: it must be 16..{MAX_SAMPLES}")
    if repeats not in ("keep", "lost"):
        raise ValueError(f"repeats is {repeats!r}: it must be keep or lost")

    def read(path: Path) -> ImportedLog:
        return _read(path, fop_hz, odr, columns, repeats == "keep")

    return read


def _read(path: Path, fop_hz: float | None, odr: int | None, columns: int, keep_repeats: bool) -> ImportedLog:
    lines = read_lines(path)
    rows = []
    for line, text in enumerate(lines, start=1):
        fields = text.split(",")
        check_columns(path, line, fields, columns, len(lines) if line > 1 else 0)
        rows.append(counts(path, line, fields, 1, 0))
    used_fop_hz = FOP_HZ if fop_hz is None else float(fop_hz)
    used_odr = ODR if odr is None else odr
    rate_hz = iq_rate_hz(used_fop_hz, used_odr)
    period_us = round(CYCLES_A_ROW * columns / rate_hz * 1e6)
    # Q = 0: there is no phase in the file, and |IQ| must be the amplitude.
    frames = [
        LoggedFrame(0, step, step * period_us, np.stack([np.zeros_like(row), row], axis=1))
        for step, row in enumerate(rows)
    ]
    repeated = repeated_rows(frames)
    if not keep_repeats:
        dropped = {step for _, step in repeated}
        frames = [frame for frame in frames if frame.step not in dropped]
    step_m = SOUND_SPEED_M_S / (2.0 * rate_hz)
    assumed = {
        "bandwidth_hz": f"{BANDWIDTH_HZ:g}",
        "role": "left, transmits",
        "row_period_us": f"{period_us}: {CYCLES_A_ROW} records, the least it can be (no clock in the file)",
        "rows": f"each the mean of {CYCLES_A_ROW} cycles, row 0 before take-off (said of them, not in them)",
    }
    if fop_hz is None:
        assumed["fop_hz"] = f"{used_fop_hz:g}"
    if odr is None:
        assumed["odr"] = f"{used_odr}"
    if fop_hz is None or odr is None:
        assumed["range_per_sample_m"] = f"{step_m:.6f}"
    facts = {
        "lost": "not known: the file has no counter; only repeated rows can be seen",
        "amplitude_only": "I = amplitude, Q = 0: |IQ| is right, phase is not there, and rows are means of envelopes, "
        "not of IQ",
        "amplitude_scale": "not stated: |IQ| as computed on the host has factor 1, amplitude computed on the sensor "
        f"{ON_CHIP_FACTOR}; taken as factor 1",
    }
    inferred = {}
    most = max(int(row.max()) for row in rows)
    if ON_CHIP_FACTOR * FULL_SCALE_COUNTS < most <= FULL_SCALE_COUNTS:
        inferred["amplitude_scale"] = (
            f"factor 1: {most} counts are more than {ON_CHIP_FACTOR} of full scale, {FULL_SCALE_COUNTS}"
        )
    elif most > FULL_SCALE_COUNTS:
        facts["over_full_scale"] = f"{most} counts are above {FULL_SCALE_COUNTS}, full scale of the ICU sensors"
    sensor = SensorLog(
        SensorInfo(sensor=0, role="left", fop_hz=used_fop_hz, bandwidth_hz=BANDWIDTH_HZ, transmits=True),
        used_odr,
        columns,
        RING_DOWN_SAMPLES,
        states_fop=fop_hz is not None,
        states_range=fop_hz is not None and odr is not None,
    )
    return ImportedLog(
        "imported amplitudes", "amplitude", (sensor,), tuple(frames), repeated, (0,), facts, inferred, assumed
    )
