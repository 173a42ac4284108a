"""The stack under test: echoes -> image -> denoise -> localise -> navigate -> MAVLink."""

from saranga.numba_cache import use_own_cache

__version__ = "0.1.0"

use_own_cache()
