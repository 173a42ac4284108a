"""The numbers of the paper that this simulator must reproduce, each worked out by the simulator itself.

`python -m sitl.paper_facts` prints the table; `tests/acceptance/test_paper_facts.py` holds every row to its tolerance.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from saranga.echo import COLUMN_M, HISTORY_ROWS, RANGE_COLUMNS, load_sonar
from saranga.wire import Decoder, Echo
from sitl.acoustics.atmosphere import Air, StandardAir, absorption_db_m
from sitl.acoustics.beam import piston_gain
from sitl.acoustics.doppler import band_loss, doppler_shift_hz
from sitl.acoustics.echoes import cylinder_amplitude, plane_amplitude
from sitl.acoustics.shield import Shield, load_shield
from sitl.acoustics.sonar import AcousticModel
from sitl.primitives import Primitives, cylinder_row, facet_row
from sitl.rig import VirtualRig
from sitl.scene_spec import Weather
from sitl.shapes.box import Box

HOVER_N = np.full(4, 0.46 * 9.80665 / 4)
LEVEL, STILL = np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3)
POSE = np.array([0.0, 0.0, -1.0])
PAIR = load_sonar("pair")
LEFT = np.array(PAIR.positions_m["left"])
@dataclass(frozen=True)
class Fact:
    """One row: `measure` gives the simulator's number, `paper` is what is printed; `contradicted`: physics does not
    allow the printed number, and agreement would mean that the simulator is wrong."""

    name: str
    unit: str
    paper: float
    tolerance: float
    measure: Callable[[], float]
    reason: str
    contradicted: bool = False

    def agrees(self, value: float) -> bool:
        """Whether `value` lies within the tolerance; NaN never does."""
        return abs(value - self.paper) <= self.tolerance

    def verdict(self, value: float) -> str:
        """PASS, FAIL, or DISAGREES (as expected)."""
        if not math.isfinite(value):
            return "FAIL"
        if self.contradicted:
            return "FAIL" if self.agrees(value) else "DISAGREES"
        return "PASS" if self.agrees(value) else "FAIL"


def _db(ratio: float) -> float:
    return 20.0 * math.log10(ratio)


def pole(range_m: float, diameter_m: float) -> Primitives:
    """An upright pole whose surface is `range_m` straight ahead of the left sensor."""
    at = POSE + LEFT + np.array([range_m + diameter_m / 2, 0.0, 0.0])
    low, high = at.copy(), at.copy()
    low[2], high[2] = 0.0, -2.0
    return Primitives.of(cylinders=[cylinder_row(low, high, diameter_m / 2, 1.0)])


def wall(range_m: float) -> Primitives:
    """A large face `range_m` ahead of the left sensor."""
    at = POSE + LEFT + np.array([range_m, 0.0, 0.0])
    return Primitives.of(facets=[facet_row(at, np.array([0.0, -1, 0]), np.array([0.0, 0, 1]), 3.0, 3.0, 1.0)])


def records(primitives: Primitives, thrust_n: NDArray[np.float64], cycles: int, *, shield: str | Shield = "none",
            air: Air | None = None) -> NDArray[np.complex128]:
    """The left sensor's records (cycles, samples) as they come off the wire of the virtual rig."""
    panel = load_shield(shield) if isinstance(shield, str) else shield
    model = AcousticModel(primitives, air or StandardAir(), PAIR, panel, 5)
    rig, decoder = VirtualRig(model, PAIR), Decoder()
    out = []
    for k in range(cycles):
        data = rig.cycle(k, 25_600 * k, POSE, LEVEL, STILL, thrust_n)
        out += [m.iq.astype(float) for m in decoder.feed(data) if isinstance(m, Echo) and m.sensor == 0]
    iq = np.array(out)
    return iq[..., 1] + 1j * iq[..., 0]


def psnr_db(range_m: float, diameter_m: float, shield: str | Shield = "none") -> float:
    """Peak of the pole's echo without noise over the RMS |IQ| of the noise at hover, through the rig's bytes."""
    echo = np.abs(records(pole(range_m, diameter_m), 0 * HOVER_N, 1)[0, 30:]).max()
    noise = records(Primitives.empty(), HOVER_N, 300, shield=shield)[:, 30:]
    return _db(float(echo / np.sqrt(np.mean(np.abs(noise) ** 2))))


def loss_db(**changes: float) -> float:
    """Insertion loss of the foam shield, changed, at hover."""
    panel = replace(load_shield("foam"), **changes)  # type: ignore[arg-type]
    return AcousticModel(Primitives.empty(), StandardAir(), PAIR, panel, 1).insertion_loss_db("left")


def pole_psnr_db(range_m: float, diameter_m: float) -> float:
    """PSNR of a pole at hover without a shield, by the laws from the paper's -4.9 dB."""
    anchor, here = cylinder_amplitude(1, 1, 0.030, 1.0), cylinder_amplitude(range_m, range_m, diameter_m / 2, 1.0)
    return -4.9 + _db(here / anchor) - 2 * absorption_db_m(53e3, StandardAir()) * (range_m - 1.0)


def seen_to_m(diameter_m: float, won_db: float, least_db: float) -> float:
    """Largest range at which a pole has a PSNR of `least_db` once `won_db` is won by a shield."""
    grid = np.linspace(0.1, 4.0, 3901)
    seen = [r for r in grid.tolist() if pole_psnr_db(r, diameter_m) + won_db >= least_db]
    return max(seen, default=math.nan)


def unaided_db() -> float:
    """PSNR at which an echo stands out of one bare record: over the highest of the N independent Rayleigh samples of
    the noise in it, sqrt(ln N) of their RMS."""
    band_hz = PAIR.noise_bandwidth_hz or PAIR.bandwidth_hz
    return 10.0 * math.log10(math.log(PAIR.samples / PAIR.iq_rate_hz * band_hz))


def flat_loss_db(near_m: float, far_m: float) -> float:
    """What a large face loses between two ranges, air included."""
    alpha = absorption_db_m(53e3, StandardAir(22.5, 31.3))
    return _db(plane_amplitude(near_m, near_m) / plane_amplitude(far_m, far_m)) + 2 * alpha * (far_m - near_m)


def unlike_clear(**weather: float) -> float:
    """Number of samples in which the records of a scene differ from those in clear air."""
    scene = Primitives.concatenate([pole(0.9, 0.06), wall(1.4)])
    clear = records(scene, HOVER_N, 5, air=Weather())
    return float(np.count_nonzero(clear != records(scene, HOVER_N, 5, air=Weather(**weather))))


def facing_over_turned_db() -> float:
    """How much the strongest echo of a cardboard box falls when it is turned by 30 degrees."""
    peak = []
    for yaw_deg in (0.0, 30.0):
        box = Box(x_m=1.3, y_m=-0.05, length_m=0.4, width_m=0.5, height_m=2.0, yaw_deg=yaw_deg, material="cardboard")
        peak.append(float(np.abs(records(box.primitives(), 0 * HOVER_N, 1)[0, 60:]).max()))
    return _db(peak[0] / peak[1])


def horn_db(azimuth_deg: float, elevation_deg: float) -> float:
    """One-way gain of the horn off its axis."""
    sines = np.sin(np.radians([azimuth_deg, elevation_deg]))
    wavenumber = 2 * math.pi * 53e3 / 343.0
    return _db(float(piston_gain(float(sines[0]), float(sines[1]), wavenumber, PAIR.a_h_m, PAIR.a_v_m)))


FACTS: tuple[Fact, ...] = (
    Fact("range loss, 0.5 to 2.0 m", "dB", 17.0, 0.5, lambda: flat_loss_db(0.5, 2.0),
         "a flat target in the paper's indoor air (22.5 C, 31.3 %): 12.0 by spreading, 4.7 by the air; a pole: 23"),
    Fact("Doppler shift at 6.3 m/s", "Hz", 1983.0, 2.0, lambda: float(doppler_shift_hz(53e3, 343.0, 6.3, 6.3)),
         "exact law; the paper rounds the carrier to 53 kHz"),
    Fact("left of the amplitude at that shift", "dB", -3.0, 0.1, lambda: _db(band_loss(1983.0, PAIR.bandwidth_hz)),
         "half the power at the edge of the 3.98 kHz band"),
    Fact("measurement cycle", "ms", 25.6, 0.05, lambda: PAIR.cycle_us / 1e3, "M = 32 cycles in 0.82 s"),
    Fact("history of an image", "s", 0.82, 0.005, lambda: HISTORY_ROWS * PAIR.cycle_us / 1e6, "M = 32"),
    Fact("record", "m", 1.66, 0.005, lambda: 343.0 * PAIR.samples / PAIR.iq_rate_hz / 2, "256 IQ samples at fop/2"),
    Fact("range of a column", "mm", 3.24, 0.01, lambda: COLUMN_M * 1e3, "1.66 m in 512 columns"),
    Fact("columns", "", 512, 0, lambda: float(RANGE_COLUMNS), "N"),
    Fact("60 mm pole at 1 m, hover, no shield", "dB", -4.9, 0.4, lambda: psnr_db(1.0, 0.060),
         "through the virtual rig's bytes, 300 cycles of noise; int16 and sampling cost up to 0.2 dB"),
    Fact("shield: loss needed for 1 m to 2 m, 60 mm pole", "dB", 12.5, 1.5, lambda: loss_db(),
         "a pole at 2 m is 12.5 dB weaker, a flat target 9.5: the foam shield takes what doubles the range"),
    Fact("sensing range of the 60 mm pole with the shield", "m", 2.0, 0.25,
         lambda: seen_to_m(0.06, loss_db(), pole_psnr_db(1.0, 0.06)), "where its PSNR is that at 1 m without one"),
    Fact("gained from 63.5 to 88.9 mm of height", "dB", 0.0, 0.5, lambda: loss_db(height_m=0.0889) - loss_db(),
         "63.5 mm is the lowest height with most of the reduction"),
    Fact("lost from 63.5 to 25.4 mm of height", "dB", 4.5, 2.5, lambda: loss_db() - loss_db(height_m=0.0254),
         "height matters: the paper's Fig. 6 shows a clear drop, without a number in the text"),
    Fact("plastic instead of foam", "dB", 0.0, 0.5,
         lambda: loss_db(thickness_m=0.0005, density_kg_m3=1240.0) - loss_db(),
         "material does not matter: the sound goes around, not through"),
    Fact("25 mm pole, no shield, no network, seen to", "m", 0.4, 0.1, lambda: seen_to_m(0.025, 0.0, unaided_db()),
         "over the highest noise of one record; the paper: thin poles (under 40 mm) often only under 0.4 m"),
    Fact("25 mm pole at 1.66 m, hover, shield", "dB", -4.9, 1.5, lambda: pole_psnr_db(1.66, 0.025) + loss_db(),
         "the paper saw it there with its network, which it says works at -4.9 dB"),
    Fact("box face, 0 over 30 degrees", "dB", 25.0, 7.0, facing_over_turned_db,
         "a turned face deflects the beam: what is left is the rounded corner, -25 to -23 dB, nearer or farther"),
    Fact("samples changed by fog", "", 0, 0, lambda: unlike_clear(fog_extinction_per_m=2.0), "the paper: no effect"),
    Fact("samples changed by snow", "", 0, 0, lambda: unlike_clear(snow_rate_mm_h=30.0), "the paper: no effect"),
    Fact("samples changed by darkness", "", 0, 0, lambda: unlike_clear(light_lux=0.0), "the paper: no effect"),
    Fact("absorption, 20 C, 50 %", "dB/m", 1.76, 0.006, lambda: absorption_db_m(53e3, StandardAir(20, 50)),
         "ISO 9613-1"),
    Fact("absorption, 22.5 C, 31.3 %", "dB/m", 1.56, 0.006, lambda: absorption_db_m(53e3, StandardAir(22.5, 31.3)),
         "ISO 9613-1, the paper's indoor air"),
    Fact("absorption, 3.9 C, 36 %", "dB/m", 0.64, 0.006, lambda: absorption_db_m(53e3, StandardAir(3.9, 36)),
         "ISO 9613-1, the paper's winter forest"),
    Fact("horn, 70 degrees to the side", "dB", -3.0, 0.15, lambda: horn_db(70.0, 0.0),
         "140 degree horn, taken as one way; the pattern is flat there: 0.1 dB are 3 degrees"),
    Fact("horn, 28.5 degrees up", "dB", -3.0, 0.15, lambda: horn_db(0.0, 28.5), "57 degree horn, taken as one way"),
    Fact("PVC pipe over a large flat face, intensity at 1 m", "", 0.5, 0.1,
         lambda: float(cylinder_amplitude(1, 1, 0.03, 1.0) / plane_amplitude(1, 1)) ** 2,
         "no spreading law gives half: a / (a + r) is that only where the radius equals the range (in amplitude: "
         "a = r / 3); a 60 mm pipe at 1 m returns 0.03", contradicted=True),
)


def table() -> str:
    """The facts with the simulator's numbers, as Markdown."""
    lines = ["| fact | simulator | paper | tolerance | verdict | reason |", "| --- | --- | --- | --- | --- | --- |"]
    for fact in FACTS:
        value = fact.measure()
        unit = f" {fact.unit}" if fact.unit else ""
        lines.append(f"| {fact.name} | {value:.4g}{unit} | {fact.paper:g}{unit} | {fact.tolerance:g} | "
                     f"{fact.verdict(value)} | {fact.reason} |")
    return "\n".join(lines)


if __name__ == "__main__":
    print(table())
