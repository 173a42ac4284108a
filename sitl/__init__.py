"""The world: clock, physics, autopilots, scenes, acoustics, virtual rig, trial."""
