"""The throttle as the emulated device holds it: a value, its token, and the deadline after which it idles by itself.

The same rules as `bench/firmware/src/dead_man.h`; a test holds the two to each other.
"""

import math

from bench.rig.faults import DeviceFaults
from saranga.wire import Throttle


class ThrottleKeeper:
    """`applied` is what the motor gets, `token` that of the command that did it (0 once idle by itself)."""

    def __init__(self, faults: DeviceFaults | None = None) -> None:
        self.applied = 0.0
        self.token = 0
        self.expires_us: float = math.inf
        self._faults = faults or DeviceFaults()

    def command(self, message: Throttle, t_us: int) -> None:
        """Hold `message.value` until its deadline; a deadline passes at exactly t + deadline."""
        stuck = self._faults.throttle_stuck
        self.applied = max(self.applied, message.value) if stuck else message.value
        self.token = message.token
        never = self._faults.no_dead_man or stuck or message.value == 0.0
        self.expires_us = math.inf if never else t_us + message.deadline_ms * 1000

    def idle(self) -> None:
        """Off, whatever was asked for."""
        self.expires_us = math.inf
        self.token = 0
        if not self._faults.throttle_stuck:
            self.applied = 0.0
