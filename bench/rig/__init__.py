"""The sonar rig: driver, checks, recording, replay, and an emulated rig that speaks the same bytes."""
