"""Denoisers, one file each, found by name; or the user's own as MODULE:NAME. Echo image in, edge strengths out."""

import sys
from typing import Any

from saranga.denoise.base import Denoiser
from saranga.errors import UsageError
from saranga.plugins import call_with_options, nearest_hint, plugins, user_object

__all__ = ["Denoiser", "denoiser_names", "load_denoiser"]


def denoiser_names() -> list[str]:
    """Names that `load_denoiser` knows."""
    return list(plugins(sys.modules[__name__]))


def load_denoiser(name: str, **options: Any) -> Denoiser:
    """The denoiser called `name`, with its own options (see `build` in its file), or the user's own.

    Args:
        name: one of `denoiser_names`, or `MODULE:NAME` where NAME is a class or factory (called with `options`) or a
            ready instance. MODULE is looked up on the import path and in the current folder.

    Raises:
        UsageError: unknown name, listing the known ones, an option it does not have, a module that cannot be imported,
            or an object that is not a denoiser.
    """
    if ":" in name:
        return _user_denoiser(name, options)
    known = plugins(sys.modules[__name__])
    if name not in known:
        raise UsageError(f"unknown denoiser {name!r}{nearest_hint(name, list(known))}: known are {', '.join(known)}; "
                         "or give your own as MODULE:NAME")
    return call_with_options("denoiser", name, known[name].build, options)


def _user_denoiser(spec: str, options: dict[str, Any]) -> Denoiser:
    needs = "name, threshold, edge_offset_m and a call with an EchoImage"
    denoiser = user_object("denoiser", spec, options, lambda target: isinstance(target, Denoiser), needs)
    missing = [m for m in ("name", "threshold", "edge_offset_m") if not hasattr(denoiser, m)]
    if not callable(denoiser):
        missing.append("__call__")
    if missing:
        raise UsageError(f"denoiser {spec!r} is not a denoiser: {type(denoiser).__name__} lacks {', '.join(missing)}; "
                         f"it needs {needs}")
    return denoiser
