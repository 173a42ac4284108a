"""Denoisers, one file each, found by name: echo image in, edge strengths out."""

import sys
from typing import Any

from saranga.denoise.base import Denoiser
from saranga.errors import UsageError
from saranga.plugins import call_with_options, nearest_hint, plugins

__all__ = ["Denoiser", "denoiser_names", "load_denoiser"]


def denoiser_names() -> list[str]:
    """Names that `load_denoiser` knows."""
    return list(plugins(sys.modules[__name__]))


def load_denoiser(name: str, **options: Any) -> Denoiser:
    """The denoiser called `name`, with its own options (see `build` in its file).

    Raises:
        UsageError: unknown name, listing the known ones, or an option it does not have.
    """
    known = plugins(sys.modules[__name__])
    if name not in known:
        raise UsageError(f"unknown denoiser {name!r}{nearest_hint(name, list(known))}: known are {', '.join(known)}")
    return call_with_options("denoiser", name, known[name].build, options)
