"""The world: clock, physics, autopilots, scenes, acoustics, virtual rig, trial."""

import saranga  # noqa: F401 - it chooses the cache of compiled kernels before numba is imported
