"""Noise of the propellers in the sensor's band: how strong, how coloured, how it swings as the blades pass.

Strength: broadband p^2 ~ U_tip^5 and T ~ U_tip^2, so p_rms ~ T^1.25 at one propeller (acoustics.md, "Propeller
noise"), summed in power over the motors, each weighted by 1 / distance^2. Anchored on the paper: unshielded, at hover
(0.46 kgf in all), the peak echo of a 60 mm PVC pole 1 m ahead is -4.9 dB against the noise's RMS |IQ|.

Colour: complex Gaussian shaped by the receiver's band, the Gaussian of `saranga.pulse` (its autocorrelation is
exp(-t^2 / (4 s^2)): 0.72 / 0.28 / 0.06 at lags of 1 to 3 samples of fop/4), and independent from cycle to cycle.
Recordings of an ICU-30201 in flight show amplitudes correlated by 0.8 / 0.45 / 0.2 at these lags: a band of about
2.2 kHz. The noise band is therefore a parameter of the sonar (`noise_bandwidth_hz`).

Swing: the intensity of high-frequency rotor noise is modulated at the blade-pass frequency (Baars et al., AIAA
2021-0713). Each motor's power carries 1 + d cos(2 pi f t + phase), f = blades x rotor speed, T ~ speed^2; the depth d
is a parameter of the airframe. A cycle lasts tens of blade passes, so the phase at the trigger is drawn.
"""

import math
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from saranga.pulse import pulse_sigma_s
from sitl.acoustics.echoes import cylinder_amplitude, plane_amplitude

if TYPE_CHECKING:
    from sitl.airframe import Airframe

ANCHOR_PSNR_DB = -4.9
ANCHOR_RADIUS_M = 0.030
ANCHOR_RANGE_M = 1.0
ANCHOR_MASS_KG = 0.46
STANDARD_GRAVITY_M_S2 = 9.80665
THRUST_EXPONENT = 1.25
"""Of the RMS pressure of one propeller; its power goes with twice this."""
BANK_ROWS = 4096
BANK_SEED = 53_000


def anchor_rms_counts(counts_at_1m: float) -> float:
    """RMS |IQ| at hover, all four motors, no shield, from the counts of a large plane at 1 m."""
    pole = cylinder_amplitude(ANCHOR_RANGE_M, ANCHOR_RANGE_M, ANCHOR_RADIUS_M, 1.0)
    plane = plane_amplitude(1.0, 1.0)
    return float(counts_at_1m * pole / plane * 10.0 ** (-ANCHOR_PSNR_DB / 20.0))


def hub_distances_m(airframe: "Airframe", sensor_m: tuple[float, float, float]) -> NDArray[np.float64]:
    """From each hub (4,) to a sensor: a propeller is a point at its hub, never nearer than its tip radius."""
    distance = np.linalg.norm(np.array(airframe.motor_positions_m) - np.array(sensor_m), axis=1)
    return np.maximum(distance, airframe.propeller_diameter_m / 2.0)


def motor_weights(airframe: "Airframe", sensor_m: tuple[float, float, float]) -> NDArray[np.float64]:
    """Share (4,) of the noise power at a sensor that each motor makes at equal thrust, 1 / distance^2; sum 1."""
    weight = 1.0 / hub_distances_m(airframe, sensor_m) ** 2
    return weight / weight.sum()


def anchor_thrust_n() -> float:
    """Thrust of one of four motors at the anchor."""
    return ANCHOR_MASS_KG * STANDARD_GRAVITY_M_S2 / 4.0


def blade_pass_hz(airframe: "Airframe", thrust_n: NDArray[np.float64]) -> NDArray[np.float64]:
    """Blade-pass frequency of each propeller at its thrust; 1.04 kHz at hover for the paper's airframe."""
    share = np.maximum(thrust_n, 0.0) / airframe.max_thrust_n
    return airframe.propeller_blades * airframe.full_speed_rpm / 60.0 * np.sqrt(share)


@lru_cache(maxsize=8)
def noise_bank(samples: int, iq_rate_hz: float, bandwidth_hz: float) -> NDArray[np.complex64]:
    """Coloured complex Gaussian rows (BANK_ROWS, samples), mean |x|^2 = 1, seamless when read around.

    Every cycle reads one row at a random start and phase, both drawn from the trial's seed. 4096 rows times the starts
    and phases outlast any flight, but a test that looks at more than 1e5 cycles should know that rows return.
    """
    rng = np.random.Generator(np.random.Philox(BANK_SEED))
    white = rng.standard_normal((BANK_ROWS, samples, 2), dtype=np.float32).view(np.complex64)[..., 0]
    frequency = np.fft.fftfreq(samples, 1.0 / iq_rate_hz)
    shape = np.exp(-2.0 * (math.pi * frequency * pulse_sigma_s(bandwidth_hz)) ** 2)
    shape /= math.sqrt(2.0 * float(np.mean(shape**2)))
    bank = np.fft.ifft(np.fft.fft(white, axis=1) * shape.astype(np.float32), axis=1).astype(np.complex64)
    bank.setflags(write=False)
    return bank
