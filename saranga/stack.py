"""The stack as one object: echo cycles in, a velocity command out, and everything it saw on the way.

`step` never raises because of what a sensor or a policy delivered: it holds position and names the fault.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from saranga.denoise import Denoiser
from saranga.disparity import match
from saranga.echo import EchoCycle, EchoFrame, EchoImage, SonarGeometry, sound_speed_m_s
from saranga.errors import UsageError
from saranga.localise import DISPARITY_TOLERANCE, Obstacle, edges, localise, positions
from saranga.navigate import EchoPolicy, Policy, VelocityCommand
from saranga.side_by_side import SideBySide

HOLD = VelocityCommand(0.0, 0.0, 0.0)
# Ten echo cycles: shorter gaps are ordinary loss, longer ones fly blind for over 0.25 m at 1 m/s.
STALE_US = 256_000
# A tick of 16 Hz: what is taken to have passed when the caller's clock was set back.
TICK_US = 62_500
# Nothing the airframe is meant to do is faster; a policy beyond it is broken, not bold.
MAX_SPEED_M_S = 5.0
# The filters along range reach over the end of the record, where coloured noise then looks like a standing edge.
END_COLUMNS = 22
DISPARITIES = ("auto", "phase", "envelope", "edges")


@dataclass
class Decision:
    """What the stack concluded at one tick.

    `images` (M, N) envelopes and `edges` (N,) newest edge rows are by sensor role; `fault` is None while all
    is well; `timing_ms` is the measured time of each stage.
    """

    t_us: int
    command: VelocityCommand
    obstacles: list[Obstacle] = field(default_factory=list)
    edges: dict[str, NDArray[np.float32]] = field(default_factory=dict)
    images: dict[str, NDArray[np.float32]] = field(default_factory=dict)
    fault: str | None = None
    timing_ms: dict[str, float] = field(default_factory=dict)


class Stack:
    """Echoes -> image -> denoise -> localise -> navigate.

    Args:
        denoiser, policy: from `load_denoiser`, `load_policy`.
        helpers: more of the same denoiser, each with a thread of its own: the sensors are shared out among them all.
            The edges are the same with and without.
        geometry: the sonar rig; a "down" sensor in it makes the localisation 3-D.
        temperature_c: sets the speed of sound.
        disparity: what azimuth comes from. `envelope`: the cross-correlation of the echoes; `phase`: that and their
            carrier (`saranga.disparity`); `edges`: the denoiser's edges alone. `auto` is phase for a sensor whose
            calibration is in `geometry`, else envelope.

    An `EchoPolicy` reads the images itself: neither denoiser nor localisation runs then.

    Raises:
        UsageError: another `disparity`, or a policy that needs obstacles with a single sensor.
    """

    def __init__(self, denoiser: Denoiser, policy: Policy, geometry: SonarGeometry,
                 temperature_c: float = 20.0, disparity: str = "auto", helpers: Sequence[Denoiser] = ()) -> None:
        if disparity not in DISPARITIES:
            raise UsageError(f"unknown disparity {disparity!r}: known are {', '.join(DISPARITIES)}")
        if not isinstance(policy, EchoPolicy) and len(geometry.positions_m) < 2:
            raise UsageError(f"stack {policy.name!r} needs two sensors, sonar {geometry.name!r} has only "
                             f"{', '.join(geometry.roles)}: choose another with --sonar, such as pair")
        self.denoiser = denoiser
        self._denoise = SideBySide([denoiser, *helpers])
        self.policy = policy
        self.geometry = geometry
        self.disparity = disparity
        self.set_temperature(temperature_c)
        self._images = {role: EchoImage() for role in geometry.positions_m}
        self._seen_us: dict[str, int | None] = dict.fromkeys(geometry.positions_m)
        self._started_us: int | None = None
        self._last_us: int | None = None
        self._set_back_us = 0

    def set_temperature(self, temperature_c: float) -> None:
        """Speed of sound for the echoes from now on; rows already in the images stay as they are."""
        self.c_m_s = sound_speed_m_s(temperature_c)

    def reset(self) -> None:
        """Forget all echoes and the policy's state."""
        self._images = {role: EchoImage() for role in self._images}
        self._seen_us = dict.fromkeys(self._images)
        self._started_us = None
        self._last_us, self._set_back_us = None, 0
        self.policy.reset()

    def warm_up(self) -> None:
        """Run every stage once on noise, so that nothing is compiled or loaded in flight; leaves nothing behind."""
        geometry = self.geometry
        noise = np.random.default_rng(0).normal(0.0, 500.0, (geometry.samples, 2)).astype(np.int16)
        for trigger in range(2):
            frames = {role: EchoFrame(role, k, trigger, trigger, trigger * geometry.cycle_us, geometry.fop_hz,
                                      geometry.odr, 0, noise) for k, role in enumerate(geometry.roles)}
            self.step([EchoCycle(trigger, trigger * geometry.cycle_us, frames)], trigger * geometry.cycle_us)
        self.reset()

    def step(self, cycles: Sequence[EchoCycle], t_us: int) -> Decision:
        """Take the cycles that arrived since the last step and decide.

        Args:
            cycles: zero or more, in trigger order.
            t_us: now, in the caller's clock; one that was set back is taken to have gone on.
        """
        decision = Decision(t_us, HOLD)
        t_us = self._steady(t_us)
        timing = decision.timing_ms
        start = perf_counter()
        if self._started_us is None:
            self._started_us = t_us
        for cycle in cycles:
            for role, image in self._images.items():
                frame = cycle.frames.get(role)
                if frame is None:
                    image.push_missing(cycle.trigger)
                    continue
                image.push(frame, self.c_m_s)
                self._seen_us[role] = t_us
        decision.images = {role: image.envelope for role, image in self._images.items()}
        timing["image"], start = _lap(start)
        decision.fault = self._silent(t_us)
        if decision.fault is not None:
            return decision

        if isinstance(self.policy, EchoPolicy):
            command = self.policy.decide_echoes(self._images, t_us)
        else:
            start = self._perceive(decision, start)
            command = self.policy.decide(decision.obstacles, t_us)
        timing["navigate"], start = _lap(start)
        decision.fault = _unusable(command, self.policy.name)
        if decision.fault is None:
            decision.command = command
        return decision

    def _steady(self, t_us: int) -> int:
        """The caller's time, never falling: else silent sensors would look fresh for as long as the clock was set
        back, and what the policy remembers would lie in its future."""
        steady_us = t_us + self._set_back_us
        if self._last_us is not None and steady_us < self._last_us:
            self._set_back_us += self._last_us + TICK_US - steady_us
            steady_us = self._last_us + TICK_US
        self._last_us = steady_us
        return steady_us

    def _perceive(self, decision: Decision, start: float) -> float:
        """Edges and obstacles into `decision`; returns when it was done."""
        timing = decision.timing_ms
        paths: dict[str, NDArray[np.float64]] = {}
        decision.edges = {role: _before_the_end(row, decision.images[role])
                          for role, row in self._denoise(self._images).items()}
        timing["denoise"], start = _lap(start)
        strength = np.zeros(0)
        for role, row in decision.edges.items():
            found, score = edges(row, self.denoiser.threshold)
            paths[role] = found - 2.0 * self.denoiser.edge_offset_m
            if role == "left":
                strength = score
        decision.obstacles = self._locate(paths, strength)
        timing["localise"], start = _lap(start)
        return start

    def _locate(self, paths: dict[str, NDArray[np.float64]], strength: NDArray[np.float64]) -> list[Obstacle]:
        geometry = self.geometry
        if self.disparity == "edges":
            return localise(paths["left"], paths["right"], paths.get("down"), geometry, strength)
        found: dict[str, NDArray[np.float64]] = {}
        for role, baseline_m in (("right", geometry.baseline_h_m), ("down", geometry.baseline_v_m)):
            if role in paths:
                known = geometry.calibration.get(role)
                on_carrier = self.disparity == "phase" or (self.disparity == "auto" and known is not None)
                found[role] = match(self._images["left"], self._images[role], paths["left"], paths[role],
                                    baseline_m * (1.0 + DISPARITY_TOLERANCE), geometry, self.c_m_s,
                                    method="phase" if on_carrier else "envelope", calibration=known).disparity_m
        return positions(paths["left"], found["right"], found.get("down"), geometry, strength)

    def _silent(self, t_us: int) -> str | None:
        """Which sensors have said nothing for too long."""
        since = {role: t_us - (seen if seen is not None else self._started_us or 0)
                 for role, seen in self._seen_us.items()}
        silent = [role for role, age_us in since.items() if age_us > STALE_US]
        if not silent:
            return "waiting for the first echoes" if None in self._seen_us.values() else None
        age_s = max(since.values()) / 1e6
        limit_s = STALE_US / 1e6
        if len(silent) == len(since):
            return f"echo source silent for {age_s:.2f} s (limit {limit_s:.2f} s)"
        return f"sensor {' and '.join(silent)} silent for {age_s:.2f} s (limit {limit_s:.2f} s)"


def _before_the_end(row: NDArray[np.float32], envelope: NDArray[np.float32]) -> NDArray[np.float32]:
    """Edges (N,) without those in the last END_COLUMNS that were measured."""
    measured = np.flatnonzero(envelope.any(axis=0))
    kept = row.copy()
    kept[max(int(measured[-1]) + 1 - END_COLUMNS, 0) if measured.size else 0:] = 0.0
    return kept


def _lap(start: float) -> tuple[float, float]:
    now = perf_counter()
    return (now - start) * 1e3, now


def _unusable(command: VelocityCommand, policy: str) -> str | None:
    values = (command.vx_m_s, command.vy_m_s, command.vz_m_s, command.yaw_rate_rad_s)
    if not all(math.isfinite(v) for v in values):
        return f"policy {policy!r} returned a command that is not finite: {values}"
    speed = math.sqrt(sum(v * v for v in values[:3]))
    if speed > MAX_SPEED_M_S:
        return f"policy {policy!r} commanded {speed:.2f} m/s (limit {MAX_SPEED_M_S:g} m/s)"
    return None
