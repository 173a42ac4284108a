"""Records of a pair of sensors as a rig would send them: pulses of known delay, phase and motion at the native rate."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saranga.echo import EchoFrame, EchoImage, SonarGeometry
from saranga.pulse import pulse
from saranga.resample import sound_speed_m_s


@dataclass(frozen=True)
class Point:
    """An echoing point in the plane, (x, y) from the middle of the pair now, moving at (vx, vy) against it."""

    x_m: float
    y_m: float
    vx_m_s: float = 0.0
    vy_m_s: float = 0.0
    counts: float = 4000.0


def paths_m(point: Point, geometry: SonarGeometry, age_s: float = 0.0) -> tuple[float, float]:
    """Paths at the left and the right sensor `age_s` ago, by Pythagoras."""
    half = geometry.baseline_h_m / 2
    x, y = point.x_m - point.vx_m_s * age_s, point.y_m - point.vy_m_s * age_s
    r_left, r_right = np.hypot(x, y + half), np.hypot(x, y - half)
    return 2 * r_left, r_left + r_right


def frames(points: list[Point], geometry: SonarGeometry, age: int, trigger: int, temperature_c: float = 20.0,
           noise_counts: float = 0.0, rng: np.random.Generator | None = None, late_m: float = 0.0,
           ahead_rad: float = 0.0) -> dict[str, EchoFrame]:
    """One cycle, `age` triggers before the newest; `late_m` and `ahead_rad` are faults of the right sensor."""
    c = sound_speed_m_s(temperature_c)
    t = np.arange(geometry.samples) / geometry.iq_rate_hz
    out = {}
    for k, role in enumerate(("left", "right")):
        record = np.zeros(geometry.samples, dtype=complex)
        for point in points:
            way = paths_m(point, geometry, age * geometry.cycle_us * 1e-6)[k]
            envelope = pulse(t - (way + late_m * k) / c, geometry.bandwidth_hz)
            record += point.counts * envelope * np.exp(-2j * np.pi * geometry.fop_hz * way / c + 1j * ahead_rad * k)
        if rng is not None:
            record += band_noise(geometry, rng) * noise_counts
        iq = np.round(np.stack([record.imag, record.real], axis=1)).astype(np.int16)
        iq[0] = 0
        out[role] = EchoFrame(role, k, trigger, trigger, trigger * geometry.cycle_us, geometry.fop_hz, geometry.odr,
                              0, iq)
    return out


def band_noise(geometry: SonarGeometry, rng: np.random.Generator) -> NDArray[np.complex128]:
    """Complex Gaussian of RMS 1 in the receiver's band."""
    t = np.arange(-40, 41) / geometry.iq_rate_hz
    kernel = pulse(t + 2.5 * 66.6e-6, geometry.bandwidth_hz)
    n = geometry.samples + kernel.size - 1
    white = (rng.standard_normal(n) + 1j * rng.standard_normal(n)) / np.sqrt(2)
    return np.convolve(white, kernel / np.sqrt(np.sum(kernel**2)), mode="valid")


def images(points: list[Point], geometry: SonarGeometry, *, rows: int = 32, heard_at_c: float = 20.0,
           change: Callable[[str, int, EchoFrame], EchoFrame | None] | None = None, **options: float,
           ) -> tuple[EchoImage, EchoImage]:
    """Left and right image of the last `rows` cycles; `change(role, age, frame)` may alter a frame or lose it."""
    rng = np.random.default_rng(int(options.pop("seed", 0)))
    pair = {"left": EchoImage(), "right": EchoImage()}
    for trigger in range(rows):
        age = rows - 1 - trigger
        for role, frame in frames(points, geometry, age, trigger, rng=rng, **options).items():
            kept = frame if change is None else change(role, age, frame)
            if kept is None:
                pair[role].push_missing(trigger)
            else:
                pair[role].push(kept, sound_speed_m_s(heard_at_c))
    return pair["left"], pair["right"]
