"""What a rig check rests on: everything the rig said in two short runs, and the signal figures taken from it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from bench.rig.device_clock import ClockDrift
from saranga.echo import EchoCycle, EchoFrame, SonarGeometry
from saranga.pulse import pulse_peak_delay_s
from saranga.wire import Hello, LinkCounters

RECORD_BEGINS_S = 1.2e-3
"""Ring-down and direct sound are over by then; 0.2 m of range."""
ALIVE_COUNTS = 5_000.0
"""A transmitter's own record saturates (20 984 counts) while it rings; a dead one shows its noise, below 200."""
HEARD_OVER_NOISE = 8.0


@dataclass(frozen=True)
class Finding:
    """One value for one limit.

    Attributes:
        limit: name in the limits file.
        of: role or other part it belongs to, "" for the whole rig.
        value: None where none could be obtained.
        samples: how many frames or cycles it rests on.
        blocked: why it cannot be judged, "" where it can: it is then INCONCLUSIVE.
        cause: what is wrong, in words and with what to do, if the limit is not kept.
    """

    limit: str
    value: float | None
    unit: str
    cause: str
    of: str = ""
    samples: int = 1
    blocked: str = ""


@dataclass
class Evidence:
    """What was heard.

    Attributes:
        hello: at the start; `tested` after the built-in test.
        link_wrong: share of wrong samples in the link test by role, None where nothing came.
        loud, quiet: the cycles of transmit/receive and of receive only.
        asked_rate_hz: of triggers. ran_s: host time from START to STOP of both runs.
        frames_lost: sequence gaps; `incomplete`, `missing`: cycles (assembler).
        sides: what the operator says of the reflector: "right", "left" or "none".
    """

    hello: Hello
    sonar: SonarGeometry
    tested: Hello | None = None
    link_wrong: dict[str, float | None] = field(default_factory=dict)
    loud: list[EchoCycle] = field(default_factory=list)
    quiet: list[EchoCycle] = field(default_factory=list)
    asked_rate_hz: float = 50.0
    ran_s: float = 0.0
    link: LinkCounters = field(default_factory=LinkCounters)
    incomplete: int = 0
    missing: int = 0
    overruns: int = 0
    unplugged: int = 0
    silences: int = 0
    restarts: int = 0
    drift: ClockDrift | None = None
    c_m_s: float = 343.2
    reflector: str = "none"
    reflector_range_m: float | None = None

    @property
    def roles(self) -> tuple[str, ...]:
        """Roles that HELLO names, in its order."""
        return tuple(s.role for s in self.hello.sensors if s.role)

    @property
    def transmitter(self) -> str | None:
        """Role of the transmitting sensor."""
        return next((s.role for s in self.hello.sensors if s.transmits and s.role), None)

    @property
    def pair(self) -> bool:
        """Whether there is a left and a right sensor."""
        return {"left", "right"} <= set(self.roles)

    def frames(self, cycles: Sequence[EchoCycle], role: str) -> list[EchoFrame]:
        """The frames of one sensor."""
        return [cycle.frames[role] for cycle in cycles if role in cycle.frames]

    def mean_record(self, role: str) -> NDArray[np.complex128] | None:
        """Coherent mean of the transmit/receive records, I real; None without frames."""
        frames = self.frames(self.loud, role)
        return np.mean([as_complex(f) for f in frames], axis=0) if frames else None

    def rate_hz(self, role: str) -> float:
        """IQ rate of a sensor's records."""
        frames = self.frames(self.loud, role) or self.frames(self.quiet, role)
        return frames[0].iq_rate_hz if frames else self.sonar.iq_rate_hz

    def noise_rms_counts(self, role: str) -> float | None:
        """RMS |IQ| of the receive-only records, their first 1.2 ms left out."""
        frames = self.frames(self.quiet, role)
        if not frames:
            return None
        first = min(math.ceil(RECORD_BEGINS_S * frames[0].iq_rate_hz), len(frames[0].iq) - 1)
        return math.sqrt(float(np.mean([np.mean(np.abs(as_complex(f)[first:]) ** 2) for f in frames])))

    def alive_counts(self) -> float | None:
        """Largest |mean IQ| of the transmitter's own record in its first 0.5 ms."""
        record = self.mean_record(self.transmitter) if self.transmitter else None
        if record is None:
            return None
        return float(np.abs(record[1:max(2, math.ceil(0.5e-3 * self.rate_hz(self.transmitter or "")))]).max())

    def silent(self) -> str:
        """Why nothing that needs sound can be judged, "" where it can."""
        alive = self.alive_counts()
        if alive is None:
            return "the transmitter sent no records"
        return "" if alive >= ALIVE_COUNTS else "the transmitter makes no sound"

    def pulse_delay_s(self, role: str) -> float:
        """From the beginning of an echo to its peak, from the sensor's stated bandwidth."""
        return pulse_peak_delay_s(next(s.bandwidth_hz for s in self.hello.sensors if s.role == role))


def as_complex(frame: EchoFrame) -> NDArray[np.complex128]:
    """The record, I real and Q imaginary."""
    return frame.iq[:, 1].astype(np.float64) + 1j * frame.iq[:, 0]


def peak_place(envelope: NDArray[np.float64], first: int, last: int) -> tuple[float, float]:
    """(place in samples, height) of the highest peak in [first, last): middle of what is above half of its height.

    A saturated peak is flat; its middle is still where it belongs.
    """
    last = min(last, len(envelope))
    if last <= first:
        return math.nan, 0.0
    top = first + int(np.argmax(envelope[first:last]))
    half = envelope[top] / 2.0
    low = high = top
    while low > 0 and envelope[low - 1] > half:
        low -= 1
    while high < len(envelope) - 1 and envelope[high + 1] > half:
        high += 1
    left = low - _share(envelope[low], envelope[low - 1], half) if low > 0 else float(low)
    right = high + _share(envelope[high], envelope[high + 1], half) if high < len(envelope) - 1 else float(high)
    return (left + right) / 2.0, float(envelope[top])


def _share(inside: float, outside: float, level: float) -> float:
    """How far from the inner sample towards the outer one the level is crossed."""
    return float((inside - level) / (inside - outside)) if inside > outside else 0.0


def reflector_lag_s(evidence: Evidence) -> tuple[float, float, int] | None:
    """(left arrives later than right by, s; peak over noise; sample of the peak in the left record), None: nothing."""
    left, right = evidence.mean_record("left"), evidence.mean_record("right")
    if left is None or right is None or len(left) != len(right):
        return None
    rate = evidence.rate_hz("left")
    first = math.ceil(RECORD_BEGINS_S * rate)
    a, b = np.abs(left), np.abs(right)
    noise = max(evidence.noise_rms_counts("left") or 0.0, evidence.noise_rms_counts("right") or 0.0)
    noise /= math.sqrt(max(len(evidence.frames(evidence.loud, "left")), 1))
    place_a, high_a = peak_place(a, first, len(a))
    place_b, high_b = peak_place(b, first, len(b))
    over = min(high_a, high_b) / max(noise, 1e-9)
    return (place_a - place_b) / rate, over, round(place_a)
