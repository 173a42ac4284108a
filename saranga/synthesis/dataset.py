"""A data set in one .npz file, and a picture of its first pairs."""

import contextlib
import json
import os
import struct
import sys
import tempfile
import time
import zipfile
import zlib
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from saranga.echo import HISTORY_ROWS, RANGE_COLUMNS
from saranga.synthesis.synthesiser import Synthesiser

CHUNK_SCENES = 64
PREVIEW_PAIRS = 6
REPORT_S = 1.0
WHITE_MEDIANS = 5.0
"""Brightness of a preview: white is this many times the median of the image."""


def write_pairs(synthesiser: Synthesiser, count: int, out: Path, image_dtype: str = "float32") -> None:
    """Write `count` pairs to `out`, which appears whole or not at all; progress on stderr."""
    roles, dtype = len(synthesiser.roles), np.dtype(image_dtype)
    truth: list[NDArray[Any]] = []
    with contextlib.ExitStack() as stack:
        part = out.with_name(f".{out.name}.{os.getpid()}.part")
        stack.callback(part.unlink, missing_ok=True)
        archive = stack.enter_context(zipfile.ZipFile(part, "w"))
        # One member of a zip file can be open at a time: labels wait in a file of their own.
        labels_file = stack.enter_context(tempfile.TemporaryFile(dir=out.parent))
        shape = (min(CHUNK_SCENES, -(-count // roles)), roles, HISTORY_ROWS, RANGE_COLUMNS)
        images, labels = np.empty(shape, dtype=np.float32), np.empty(shape, dtype=np.float32)
        synthesiser.fill(0, images[:1], labels[:1])  # a first call compiles, which is no part of the rate
        done, began, reported = 0, time.perf_counter(), time.perf_counter()
        with archive.open("images.npy", "w", force_zip64=True) as member:
            _header(member, (count, HISTORY_ROWS, RANGE_COLUMNS), dtype)
            while done < count:
                n = min(shape[0], -(-(count - done) // roles))
                truth.append(synthesiser.fill(done // roles, images[:n], labels[:n]))
                pairs = min(n * roles, count - done)
                flat = images[:n].reshape(-1, HISTORY_ROWS, RANGE_COLUMNS)[:pairs]
                member.write(np.ascontiguousarray(flat, dtype=dtype).data)
                flat = labels[:n].reshape(-1, HISTORY_ROWS, RANGE_COLUMNS)[:pairs]
                labels_file.write(np.rint(255.0 * flat).astype(np.uint8).data)
                done += pairs
                now = time.perf_counter()
                if now - reported > REPORT_S or done == count:
                    reported = now
                    rate = done / (now - began)
                    print(f"\r{done}/{count} pairs, {rate:.0f}/s, {(count - done) / rate:.0f} s left  ", end="",
                          file=sys.stderr, flush=True)
        print(file=sys.stderr)
        labels_file.seek(0)
        with archive.open("labels.npy", "w", force_zip64=True) as member:
            _header(member, (count, HISTORY_ROWS, RANGE_COLUMNS), np.dtype(np.uint8))
            while block := labels_file.read(1 << 20):
                member.write(block)
        index = np.arange(count)
        for key, array in (("scene", index // roles), ("role", np.array(synthesiser.roles)[index % roles]),
                           ("truth", np.concatenate(truth)),
                           ("provenance", np.array(json.dumps(synthesiser.provenance())))):
            with archive.open(f"{key}.npy", "w") as member:
                np.lib.format.write_array(member, array, allow_pickle=False)
        archive.close()
        part.replace(out)


def preview(synthesiser: Synthesiser, count: int) -> bytes:
    """PNG of the first pairs, at most PREVIEW_PAIRS of `count`."""
    shown = min(PREVIEW_PAIRS, count)
    batch = synthesiser.batch(0, -(-shown // len(synthesiser.roles)))
    shape = (-1, HISTORY_ROWS, RANGE_COLUMNS)
    return preview_png(batch.images.reshape(shape)[:shown], batch.labels.reshape(shape)[:shown])


def preview_png(images: NDArray[np.float32], labels: NDArray[np.float32]) -> bytes:
    """Pairs as an 8-bit grey PNG: one below the other, image beside its label.

    The newest row is the lowest, range grows to the right; rows are drawn 3 points high.
    """
    strips = []
    for image, label in zip(images, labels, strict=True):
        white = max(WHITE_MEDIANS * float(np.median(image)), 1e-9)
        picture = np.hstack([image / white, np.ones((len(image), 4)), label])
        strips += [np.repeat(picture, 3, axis=0), np.full((6, picture.shape[1]), 0.5)]
    grey = np.rint(255.0 * np.clip(np.vstack(strips), 0.0, 1.0)).astype(np.uint8)

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    lines = b"".join(b"\0" + row.tobytes() for row in grey)
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", grey.shape[1], grey.shape[0], 8, 0, 0, 0, 0))
            + chunk(b"IDAT", zlib.compress(lines)) + chunk(b"IEND", b""))


def _header(member: IO[bytes], shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
    np.lib.format.write_array_header_2_0(
        member, {"descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": shape})
