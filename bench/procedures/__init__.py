"""Bench procedures: noise sweeps and shield comparisons, beam pattern, reference echo, sensor accuracy, energy."""
