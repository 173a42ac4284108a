"""Things found by name: every module of a package that has a `NAME` and a `build(**options)` is one of them.

Adding a denoiser or a policy is adding one file; there is no list to keep.
"""

import difflib
import importlib
import inspect
import pkgutil
from types import ModuleType
from typing import Any

from saranga.errors import UsageError


def plugins(package: ModuleType) -> dict[str, ModuleType]:
    """Modules of `package` that declare a `NAME`, by that name, sorted."""
    found: dict[str, ModuleType] = {}
    for entry in pkgutil.iter_modules(package.__path__):
        module = importlib.import_module(f"{package.__name__}.{entry.name}")
        if hasattr(module, "NAME") and hasattr(module, "build"):
            found[module.NAME] = module
    return dict(sorted(found.items()))


def nearest_hint(name: str, known: list[str]) -> str:
    """" (did you mean 'x'?)" or an empty string."""
    near = difflib.get_close_matches(name, known, n=1)
    return f" (did you mean {near[0]!r}?)" if near else ""


def call_with_options(kind: str, name: str, factory: Any, options: dict[str, Any]) -> Any:
    """`factory(**options)`, with an unknown option named in a UsageError instead of a TypeError.

    Raises:
        UsageError: an option the factory does not have, or a value it refuses (ValueError).
    """
    try:
        accepted = inspect.signature(factory).parameters
    except (TypeError, ValueError):
        accepted = None
    if accepted is not None and not any(p.kind is p.VAR_KEYWORD for p in accepted.values()):
        for option in options:
            if option not in accepted:
                raise UsageError(f"{kind} {name!r} has no option {option!r}{nearest_hint(option, list(accepted))}: "
                                 f"known are {', '.join(accepted) or 'none'}")
    try:
        return factory(**options)
    except ValueError as error:
        raise UsageError(f"{kind} {name!r}: {error}") from error
