"""Drivers of thrust stands and throttles, one file each, found by its `NAME`; see `bench/thrust_stand/registry.py`."""
