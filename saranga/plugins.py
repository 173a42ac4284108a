"""Things found by name: every module of a package that has a `NAME` and a `build(**options)` is one of them.

Adding a denoiser or a policy is adding one file; there is no list to keep. Or the user's own by MODULE:NAME.
"""

import difflib
import importlib
import importlib.util
import inspect
import pkgutil
import sys
from collections.abc import Callable
from pathlib import Path
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


def user_target(kind: str, spec: str) -> Any:
    """What `MODULE:NAME` names: a class, a factory or an instance. MODULE may lie in the current folder.

    Raises:
        UsageError: not of this form, a module that cannot be imported, or an attribute that it does not have.
    """
    module_name, _, attribute = spec.partition(":")
    if not module_name or not attribute:
        raise UsageError(f"{kind} {spec!r} is not MODULE:NAME: give both, such as my_module:Mine")
    module = _import(kind, spec, module_name)
    try:
        return getattr(module, attribute)
    except AttributeError:
        public = [n for n in vars(module) if not n.startswith("_")]
        raise UsageError(f"{kind} {spec!r}: {module.__name__} has no {attribute!r}{nearest_hint(attribute, public)}: "
                         "name a class, a factory or an instance in it") from None


def user_object(kind: str, spec: str, options: dict[str, Any], ready: Callable[[Any], bool], needs: str) -> Any:
    """The object that `MODULE:NAME` names, called with `options` unless it is `ready` as it stands.

    Args:
        kind, needs: for the messages: "stack", "name, reset() and decide(obstacles, t_us)".

    Raises:
        UsageError: as `user_target`, or it cannot be built.
    """
    target = user_target(kind, spec)
    if not isinstance(target, type) and ready(target):
        return target
    if not callable(target):
        raise UsageError(f"{kind} {spec!r} cannot be one: it is a {type(target).__name__}; name a class, a factory or "
                         f"an instance with {needs}")
    try:
        return call_with_options(kind, spec, target, options)
    except TypeError as error:
        raise UsageError(f"{kind} {spec!r} cannot be built: {error}; its arguments must have defaults") from error


def user_source(spec: str) -> Path | None:
    """The file that holds MODULE of `MODULE:NAME`; None where there is none, or for a shipped name."""
    module_name, colon, _ = spec.partition(":")
    if not colon or not module_name:
        return None
    here = str(Path.cwd())
    sys.path.insert(0, here)
    try:
        found = importlib.util.find_spec(module_name)
    except (ImportError, ValueError):
        return None
    finally:
        sys.path.remove(here)
    return Path(found.origin) if found is not None and found.origin and Path(found.origin).is_file() else None


def _import(kind: str, spec: str, module_name: str) -> ModuleType:
    here = str(Path.cwd())
    sys.path.insert(0, here)
    try:
        return importlib.import_module(module_name)
    except ImportError as error:
        raise UsageError(f"{kind} {spec!r}: module {module_name!r} cannot be imported ({error}): "
                         "check the name, or run from the folder that holds it") from error
    finally:
        sys.path.remove(here)
