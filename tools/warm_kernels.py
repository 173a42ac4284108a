"""Compiles the numba kernels into their cache by flying once with each classical denoiser.

Run before the tests: those in wall time would otherwise wait for the compiler in the middle of a flight. It takes
about a minute after a change of the sources, and a few seconds when there is nothing to compile.
"""

from sitl.trial import run_trial
from sitl.trial_types import TrialRequest

for denoiser in ("tbd", "gaussian", "saranga"):
    run_trial(TrialRequest("poles", denoiser=denoiser))
