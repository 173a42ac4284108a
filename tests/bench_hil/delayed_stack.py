"""A stack that is late on purpose: straight ahead, after HIL_DELAY_MS milliseconds of doing nothing."""

import os
import time

from saranga.navigate import VelocityCommand


class Delayed:
    name = "delayed"

    def __init__(self, desired_speed_m_s: float = 1.0) -> None:
        self.command = VelocityCommand(desired_speed_m_s, 0.0, 0.0)
        self.delay_s = float(os.environ["HIL_DELAY_MS"]) / 1e3

    def reset(self) -> None:
        pass

    def decide(self, obstacles: object, t_us: int) -> VelocityCommand:
        time.sleep(self.delay_s)
        return self.command
