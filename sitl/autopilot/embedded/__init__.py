"""A small guided-mode copter on the same physics, for flights without an ArduPilot build."""

from sitl.autopilot.embedded.autopilot import EmbeddedAutopilot

__all__ = ["EmbeddedAutopilot"]
