"""The harness and the hardware: pytest plugin, command line, verdicts, journal, reports."""

import saranga  # noqa: F401 - it chooses the cache of compiled kernels before numba is imported
