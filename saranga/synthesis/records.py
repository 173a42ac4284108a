"""Recorded rows on the range grid, from a rig's recording or from arrays."""

import zipfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from saranga.echo import EchoFrame, resample
from saranga.errors import UsageError
from saranga.recording import read_recording
from saranga.resample import RANGE_COLUMNS
from saranga.wire import Decoder, Echo

RECEIVE_ONLY, TRANSMIT_RECEIVE = 1, 0


def read_rows(path: Path, mode: int, c_m_s: float) -> NDArray[np.complex64]:
    """Cycles of a recording, resampled to the network's columns.

    Args:
        path: .mcap of the rig; or .npz with `iq`, int16 (K, n, 2) with Q first as the sensor gives it, `fop_hz` and
            `odr`; or .npy / .npz with `iq` complex (K, 512), already on the range grid.
        mode: which cycles of an .mcap count, RECEIVE_ONLY or TRANSMIT_RECEIVE.
        c_m_s: speed of sound when it was recorded.

    Returns:
        complex64 (K, RANGE_COLUMNS), counts / FULL_SCALE; columns that were not recorded are 0.

    Raises:
        UsageError: not such a file, no such cycles, or values that are not finite.
    """
    if not path.is_file():
        raise UsageError(f"recording {str(path)!r} does not exist: give an .mcap, .npz or .npy file")
    rows = _from_mcap(path, mode, c_m_s) if path.suffix == ".mcap" else _from_arrays(path, c_m_s)
    if not np.isfinite(rows).all():
        bad = int((~np.isfinite(rows)).any(axis=1).sum())
        raise UsageError(f"{path}: {bad} of {len(rows)} rows have values that are not finite: remove them")
    return rows


def _from_mcap(path: Path, mode: int, c_m_s: float) -> NDArray[np.complex64]:
    decoder = Decoder()
    rows: list[NDArray[np.complex64]] = []
    other = 0
    for _, data in read_recording(path).frames():
        for message in decoder.feed(data):
            if isinstance(message, Echo):
                if message.mode != mode:
                    other += 1
                    continue
                frame = EchoFrame("left", message.sensor, message.sequence, message.trigger, message.device_time_us,
                                  message.fop_hz, message.odr, message.mode, message.iq)
                rows.append(resample(frame, c_m_s))
    if not rows:
        want = "receive-only" if mode == RECEIVE_ONLY else "transmit/receive"
        raise UsageError(f"{path}: no {want} cycles in it ({other} of the other mode): record with the rig in "
                         f"{want} mode")
    return np.stack(rows)


def _from_arrays(path: Path, c_m_s: float) -> NDArray[np.complex64]:
    try:
        loaded = np.load(path, allow_pickle=False)
        tables = {"iq": loaded} if isinstance(loaded, np.ndarray) else {key: loaded[key] for key in loaded.files}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise UsageError(f"{path}: not a readable .npz or .npy file: {error}") from error
    iq = tables.get("iq")
    if iq is None:
        raise UsageError(f"{path}: no array 'iq' in it (it has {', '.join(tables) or 'nothing'})")
    if np.iscomplexobj(iq):
        if iq.ndim != 2 or iq.shape[1] != RANGE_COLUMNS or len(iq) == 0:
            raise UsageError(f"{path}: complex iq has shape {iq.shape}: it must be (rows, {RANGE_COLUMNS}), on the "
                             "range grid")
        return iq.astype(np.complex64)
    if iq.ndim != 3 or iq.shape[2] != 2 or len(iq) == 0 or iq.dtype != np.int16:
        raise UsageError(f"{path}: iq is {iq.dtype} of shape {iq.shape}: it must be int16 (rows, samples, 2), Q first, "
                         f"or complex (rows, {RANGE_COLUMNS})")
    if "fop_hz" not in tables or "odr" not in tables:
        raise UsageError(f"{path}: native iq needs fop_hz and odr beside it: add them to the file")
    fop_hz, odr = float(tables["fop_hz"]), int(tables["odr"])
    return np.stack([resample(EchoFrame("left", 0, k, k, 0, fop_hz, odr, 0, row), c_m_s) for k, row in enumerate(iq)])


def recorded_span(rows: NDArray[np.complex64]) -> tuple[int, int]:
    """First and past-the-last column that any row has something in; columns outside were not recorded."""
    some = np.flatnonzero(np.any(rows != 0, axis=0))
    return (int(some[0]), int(some[-1]) + 1) if some.size else (0, 0)


