"""Preflight: evidence of vehicle, rig and this computer gathered once, then one check a file, each a pure function."""
