"""Motion of the sensors: frequency shift, loss in the receiver's band, and the delay at the moving receiver."""

import math

from numba import njit


@njit(cache=True)
def doppler_shift_hz(fop_hz, c_m_s, speed_tx_m_s, speed_rx_m_s):  # type: ignore[no-untyped-def]
    """Shift of the echo's carrier: fop ((c + v_rx) / (c - v_tx) - 1), speeds towards the reflection point.

    Exact; with both speeds v it is the paper's f (c + v) / (c - v): 1983 Hz at 6.3 m/s.
    """
    return fop_hz * ((c_m_s + speed_rx_m_s) / (c_m_s - speed_tx_m_s) - 1.0)


@njit(cache=True)
def band_loss(shift_hz, bandwidth_hz):  # type: ignore[no-untyped-def]
    """Amplitude left of an echo shifted within a resonator of -3 dB bandwidth B: 1 / sqrt(1 + (2 f / B)^2).

    -0.4 dB at 622 Hz (2 m/s), -3 dB at 1983 Hz (6.3 m/s) for 3.98 kHz (acoustics.md, "Doppler").
    """
    x = 2.0 * shift_hz / bandwidth_hz
    return 1.0 / math.sqrt(1.0 + x * x)


@njit(cache=True)
def moving_delay_s(d1_m, d2_m, speed_rx_m_s, c_m_s):  # type: ignore[no-untyped-def]
    """Delay to a receiver that closes in on the reflection point at `speed_rx_m_s` from the trigger on.

    d1 and d2 are the distances at the trigger; 0.58 % less than (d1 + d2) / c at 2 m/s where d1 = d2.
    """
    out = d1_m / c_m_s
    return out + (d2_m - speed_rx_m_s * out) / (c_m_s + speed_rx_m_s)
