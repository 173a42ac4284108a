"""Finds the throttle for a wanted thrust in slow integral steps; limits and slew belong to the supervisor."""

import math

STEP_S = 0.25
GAIN = 0.5
CLOSE = 0.01
LARGEST_STEP = 0.08


class ThrustSeeker:
    """Holds a thrust of one motor.

    Thrust grows about with the square of throttle, so the next throttle is taken from sqrt(wanted / read), half of
    the way, at most 0.08 at once. `close_enough`: the last mean is within 1 %.
    """

    def __init__(self, wanted_n: float, most_throttle: float, throttle: float) -> None:
        self._wanted_n = wanted_n
        self._most = most_throttle
        self.throttle = throttle if throttle > 0.0 else 0.15
        self.close_enough = False
        self._held = False
        self._values: list[float] = []
        self._next_s = STEP_S

    def hold(self) -> None:
        """Leave the throttle as it is from here on."""
        self._held = True

    def next(self, thrust_n: float, now_s: float) -> float:
        """The throttle after one reading, `now_s` since the level was set."""
        if math.isfinite(thrust_n):
            self._values.append(thrust_n)
        if self._held or now_s < self._next_s or not self._values:
            return self.throttle
        self._next_s = now_s + STEP_S
        recent = self._values[-6:]
        mean = sum(recent) / len(recent)
        self._values.clear()
        self.close_enough = abs(mean - self._wanted_n) <= CLOSE * self._wanted_n
        if not self.close_enough:
            ratio = math.sqrt(self._wanted_n / max(mean, 0.02 * self._wanted_n))
            step = GAIN * (ratio - 1.0) * self.throttle
            self.throttle = min(self._most, self.throttle + min(max(step, -LARGEST_STEP), LARGEST_STEP))
        return self.throttle
