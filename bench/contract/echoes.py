"""Made-up echoes for the contract: noise, a pole, and what sensors and cables do to them. Deterministic."""

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from saranga.echo import COLUMN_M, HISTORY_ROWS, EchoCycle, EchoFrame, EchoImage, SonarGeometry, load_sonar

C_M_S = 343.2
NOISE_COUNTS = 60.0
POLE_COUNTS = 4000.0
POLE_M = 0.8
PULSE_S = 150e-6


def record(geometry: SonarGeometry, seed: int, range_m: float | None = POLE_M) -> NDArray[np.int16]:
    """(n, 2) int16 of one cycle: receiver noise, and a pole's echo 36 dB over it."""
    rng = np.random.default_rng([seed, 0xC0DE])
    t_s = np.arange(geometry.samples) / (geometry.fop_hz / 2.0 ** (7 - geometry.odr))
    signal = NOISE_COUNTS * (rng.standard_normal(len(t_s)) + 1j * rng.standard_normal(len(t_s)))
    if range_m is not None:
        tau_s = 2.0 * range_m / C_M_S
        shape = np.where(t_s < tau_s, 0.0, np.exp(-np.maximum(t_s - tau_s - PULSE_S, 0.0) / PULSE_S)
                         * np.clip((t_s - tau_s) / PULSE_S, 0.0, 1.0))
        signal = signal + POLE_COUNTS * shape * np.exp(-2j * np.pi * geometry.fop_hz * tau_s)
    return np.rint(np.stack([signal.imag, signal.real], axis=1)).clip(-32768, 32767).astype(np.int16)


def frame(geometry: SonarGeometry, role: str, trigger: int, iq: NDArray[np.int16]) -> EchoFrame:
    return EchoFrame(role, geometry.roles.index(role), trigger, trigger, trigger * geometry.cycle_us, geometry.fop_hz,
                     geometry.odr, 0, iq)


def pole_cycles(geometry: SonarGeometry, count: int = HISTORY_ROWS, range_m: float | None = POLE_M,
                lost: Sequence[int] = ()) -> list[EchoCycle]:
    """Cycles of a pole straight ahead that stands still; those `lost` never come."""
    return [EchoCycle(trigger, trigger * geometry.cycle_us, {
        role: frame(geometry, role, trigger, record(geometry, 100 * trigger + k, range_m))
        for k, role in enumerate(geometry.roles)}) for trigger in range(count) if trigger not in lost]


def images(geometry: SonarGeometry, cycles: Iterable[EchoCycle]) -> dict[str, EchoImage]:
    """By role, after all of them."""
    found = {role: EchoImage() for role in geometry.roles}
    for cycle in cycles:
        for role, image in found.items():
            image.push(cycle.frames[role], C_M_S)
    return found


def pole_image(range_m: float | None = POLE_M, lost: Sequence[int] = (), count: int = HISTORY_ROWS) -> EchoImage:
    """The left sensor's."""
    geometry = load_sonar("pair")
    return images(geometry, pole_cycles(geometry, count, range_m, lost))["left"]


def constant_image(counts: int) -> EchoImage:
    """Every sample of every cycle the same: 0 is a receiver that is off, 32767 one that is saturated."""
    geometry, image = load_sonar("pair"), EchoImage()
    iq = np.full((geometry.samples, 2), counts, np.int16)
    for trigger in range(HISTORY_ROWS):
        image.push(frame(geometry, "left", trigger, iq), C_M_S)
    return image


def broken_image() -> EchoImage:
    """A pole, but one row that is not a number: what a bug before the denoiser may leave."""
    image = pole_image()
    image.iq[-1, 100:200] = complex(float("nan"), float("nan"))
    image._stale = HISTORY_ROWS
    return image


def columns_near(range_m: float, tolerance_m: float) -> slice:
    return slice(round((range_m - tolerance_m) / COLUMN_M), round((range_m + tolerance_m) / COLUMN_M) + 1)
