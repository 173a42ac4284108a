"""How long perception takes on one thread, and what it finds: `make bench`."""

from collections.abc import Callable

import numpy as np
import pytest
from synthetic_images import SyntheticImage, draw_reflector, image, noise

from saranga.denoise import load_denoiser
from saranga.localise import edges, localise
from saranga.navigate import load_policy
from saranga.resample import COLUMN_M
from saranga.sonar_geometry import load_sonar

# 20 times real time leaves 3.1 ms of wall time a stack tick of 62.5 ms, for two images and all the rest
LIMIT_MS = {"gaussian": 0.15, "tbd": 3.0}


@pytest.mark.parametrize("name", sorted(LIMIT_MS))
def test_denoiser(denoiser_within: Callable[[str, float], None], name: str) -> None:
    denoiser_within(name, LIMIT_MS[name])


def test_edges_localise_and_decide(benchmark) -> None:
    row = np.zeros(512, dtype=np.float32)
    row[[100, 101, 250, 251, 400]] = 0.9, 0.3, 0.4, 0.8, 0.7
    geometry = load_sonar("pair")
    policy = load_policy("saranga")

    def tick() -> None:
        left, strength = edges(row, 0.5)
        policy.decide(localise(left, left - 0.01, None, geometry, strength), 0)

    tick()
    benchmark(tick)
    assert benchmark.stats["median"] * 1e3 <= 0.3


@pytest.mark.parametrize("name", sorted(LIMIT_MS))
def test_table_of_hit_rates(benchmark, tables: list[str], name: str) -> None:
    lines = benchmark.pedantic(_table, args=(name, 150), rounds=1)
    tables.append("\n".join(lines))
    assert len(lines) == 7


def _table(name: str, images: int) -> list[str]:
    denoiser = load_denoiser(name)
    empty = [SyntheticImage(noise(np.random.default_rng(70_000 + i))) for i in range(images)]
    false = sum(edges(denoiser(p), denoiser.threshold)[0].size for p in empty)  # type: ignore[arg-type]
    lines = [f"{name}: {false / images:.3f} false edges a frame of noise at threshold {denoiser.threshold:g}",
             "PSNR dB   strongest within 5 cm   over threshold   mean mm    std mm"]
    for psnr_db in (15.0, 10.0, 5.0, 0.0, -4.9):
        best = hits = 0
        misses = []
        for i in range(images):
            rng = np.random.default_rng(i)
            reflector = draw_reflector(rng)
            row = denoiser(image([reflector], psnr_db, rng))  # type: ignore[arg-type]
            best += abs(np.argmax(row) * COLUMN_M - denoiser.edge_offset_m - reflector.range_m) < 0.05
            off = edges(row, denoiser.threshold, offset_m=denoiser.edge_offset_m)[0] / 2 - reflector.range_m
            near = off[np.abs(off) < 0.05]
            hits += bool(near.size)
            misses += list(near * 1e3)
        mean, std = (np.mean(misses), np.std(misses)) if misses else (np.nan, np.nan)
        lines.append(f"{psnr_db:7.1f}   {best / images:21.3f}   {hits / images:14.3f}   {mean:7.2f}   {std:7.2f}")
    return lines
