"""Checks before a flight, one a file: a NAME, and `build()` that gives a function from Evidence to Findings."""
