"""The sonar rig on the bench: recordings made elsewhere become ordinary rig recordings."""
