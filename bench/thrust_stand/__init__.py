"""Thrust stands: what measures (`ThrustStand`) and what spins (`ThrottleOutput`), one driver a file, found by name."""
