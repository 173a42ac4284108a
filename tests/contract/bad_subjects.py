"""Denoisers and policies with one fault each, and which test of the contract must find it."""

import itertools
import math
import time
from typing import Any

import numpy as np

from saranga.denoise import load_denoiser
from saranga.navigate import VelocityCommand

AHEAD = VelocityCommand(1.0, 0.0, 0.0)
_counter = itertools.count()


class _Denoiser:
    """A good one, to be spoilt."""

    name = "spoilt"

    def __init__(self) -> None:
        self._inner = load_denoiser("gaussian")
        self.threshold = self._inner.threshold
        self.edge_offset_m = self._inner.edge_offset_m

    def __call__(self, image: Any) -> Any:
        return self._inner(image)


class Float64(_Denoiser):
    def __call__(self, image: Any) -> Any:
        return super().__call__(image).astype(np.float64)


class WrongShape(_Denoiser):
    def __call__(self, image: Any) -> Any:
        return super().__call__(image)[:256]


class NoThreshold(_Denoiser):
    def __init__(self) -> None:
        super().__init__()
        self.threshold = math.nan


class Blind(_Denoiser):
    def __call__(self, image: Any) -> Any:
        return np.zeros(512, np.float32)


class SeesGhosts(_Denoiser):
    """An obstacle in every image of too few cycles, and in silence."""

    def __call__(self, image: Any) -> Any:
        out = super().__call__(image)
        if not image.envelope.any():
            out[100] = 1.0
        return out


class Divides(_Denoiser):
    """The usual slip: by a level that is zero in an image of zeros."""

    def __call__(self, image: Any) -> Any:
        level = image.envelope.max()
        with np.errstate(all="ignore"):
            return (super().__call__(image) * (level / level)).astype(np.float32)


class PassesNan(_Denoiser):
    def __call__(self, image: Any) -> Any:
        out = super().__call__(image)
        return out if np.isfinite(image.envelope[-1]).all() else np.full_like(out, np.nan)


class OverOne(_Denoiser):
    def __call__(self, image: Any) -> Any:
        return super().__call__(image) * np.float32(3.0)


class Scribbles(_Denoiser):
    def __call__(self, image: Any) -> Any:
        out = super().__call__(image)
        image.envelope[:] *= 0.5
        return out


class Random(_Denoiser):
    def __call__(self, image: Any) -> Any:
        out = super().__call__(image)
        out[300 + next(_counter) % 100] = 0.01
        return out


class MixesSensors(_Denoiser):
    """Remembers the last image, whichever sensor it was of."""

    def __init__(self) -> None:
        super().__init__()
        self._last = np.zeros(512, np.float32)

    def __call__(self, image: Any) -> Any:
        out = super().__call__(image)
        mixed = np.maximum(out, np.float32(0.5) * self._last)
        self._last = out
        return mixed


class NeedsEveryRow(_Denoiser):
    def __call__(self, image: Any) -> Any:
        complete = image.rows < 32 or image.envelope.any(axis=1).all()
        return super().__call__(image) if complete else np.zeros(512, np.float32)


class Slow(_Denoiser):
    def __call__(self, image: Any) -> Any:
        time.sleep(0.040)
        return super().__call__(image)


class _Policy:
    name = "spoilt"

    def __init__(self, desired_speed_m_s: float = 1.0) -> None:
        self.reset()

    def reset(self) -> None:
        self.ticks = 0

    def decide(self, obstacles: Any, t_us: int) -> Any:
        return AHEAD


class NanCommand(_Policy):
    def decide(self, obstacles: Any, t_us: int) -> Any:
        return VelocityCommand(1.0 / obstacles[0].range_m if obstacles and obstacles[0].range_m else math.nan, 0.0, 0.0)


class TooFast(_Policy):
    def decide(self, obstacles: Any, t_us: int) -> Any:
        return VelocityCommand(0.1 / max(min((o.range_m for o in obstacles), default=1.0), 1e-3), 0.0, 0.0)


class Tuple(_Policy):
    def decide(self, obstacles: Any, t_us: int) -> Any:
        return (1.0, 0.0, 0.0)


class Raises(_Policy):
    def decide(self, obstacles: Any, t_us: int) -> Any:
        return VelocityCommand(0.0, min(o.y_m for o in obstacles), 0.0)


class Remembers(_Policy):
    """Its reset forgets to forget."""

    def __init__(self, desired_speed_m_s: float = 1.0) -> None:
        self.ticks = 0

    def reset(self) -> None:
        pass

    def decide(self, obstacles: Any, t_us: int) -> Any:
        self.ticks += 1
        return VelocityCommand(min(0.01 * self.ticks, 1.0), 0.0, 0.0)


class Draws(_Policy):
    def decide(self, obstacles: Any, t_us: int) -> Any:
        return VelocityCommand(1.0, 1e-3 * (next(_counter) % 100), 0.0)


class Empties(_Policy):
    def decide(self, obstacles: Any, t_us: int) -> Any:
        obstacles.clear() if isinstance(obstacles, list) else None
        return AHEAD


class TimeDivides(_Policy):
    """Divides by the time since the last call."""

    def reset(self) -> None:
        self.last_us = -62_500

    def decide(self, obstacles: Any, t_us: int) -> Any:
        step_us, self.last_us = t_us - self.last_us, t_us
        return VelocityCommand(62_500 / step_us, 0.0, 0.0)


class BlindFlight(_Policy):
    """An echo policy that flies on whatever the images hold."""

    def decide_echoes(self, images: Any, t_us: int) -> Any:
        return AHEAD


class NotNumbers(_Policy):
    def decide(self, obstacles: Any, t_us: int) -> Any:
        return VelocityCommand(1.0, sum(0.01 * o.y_m for o in obstacles), 0.0)


class SlowPolicy(_Policy):
    def decide(self, obstacles: Any, t_us: int) -> Any:
        time.sleep(0.075)
        return AHEAD


FOUND_BY = {
    "Float64": "right_shape_and_type", "WrongShape": "right_shape_and_type", "NoThreshold": "name_threshold_and_offset",
    "Blind": "sees_a_strong_echo", "SeesGhosts": "nothing_where_there_was_no_echo", "Divides": "nothing_in_zeros",
    "PassesNan": "not a number", "OverOne": "right_shape_and_type",
    "Scribbles": "leaves_its_input_alone", "Random": "is_deterministic", "MixesSensors": "keeps_the_sensors_apart",
    "NeedsEveryRow": "survives_lost_rows", "Slow": "quick_enough",
    "NanCommand": "nothing", "TooFast": "at the sensor", "Tuple": "usable_command",
    "Raises": "nothing", "Remembers": "reset_forgets", "Draws": "is_deterministic",
    "Empties": "leaves_its_input_alone", "TimeDivides": "time_that_stands_still", "BlindFlight": "without_echoes",
    "NotNumbers": "not_a_number", "SlowPolicy": "quick_enough",
}
"""Class name -> part of the name of a test that must fail for it."""
