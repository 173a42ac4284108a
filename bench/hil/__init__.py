"""Companion in the loop: the world and an autopilot served to a companion computer in wall time, and its timing."""
