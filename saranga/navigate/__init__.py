"""Navigation policies, one file each, found by name; or the user's own as MODULE:NAME."""

import importlib
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

from saranga.errors import UsageError
from saranga.navigate.base import EchoPolicy, Policy, VelocityCommand
from saranga.plugins import call_with_options, nearest_hint, plugins

DEFAULT_SONAR = "pair"

__all__ = ["DEFAULT_SONAR", "EchoPolicy", "Policy", "VelocityCommand", "load_policy", "policy_names", "sonar_of"]


def policy_names() -> list[str]:
    """Names that `load_policy` knows."""
    return list(plugins(sys.modules[__name__]))


def sonar_of(name: str) -> str:
    """The suite in fixtures/sonars that policy `name` is made for: its module's SONAR, else `pair`.

    A user's own policy may say it by an attribute `sonar` of the class or instance. Never raises: a name that is
    not known is reported by `load_policy`.
    """
    module_name, colon, attribute = name.partition(":")
    if not colon:
        return str(getattr(plugins(sys.modules[__name__]).get(name), "SONAR", DEFAULT_SONAR))
    try:
        target = _attribute(_import(name, module_name), name, attribute)
    except UsageError:
        return DEFAULT_SONAR
    return str(getattr(target, "sonar", DEFAULT_SONAR))


def load_policy(name: str, **params: Any) -> Policy:
    """The policy called `name`, or the user's own from `MODULE:NAME`.

    Args:
        name: `saranga`, `batdeck`, `none`, or `MODULE:NAME` where NAME is a class or factory (called with `params`)
            or a ready instance. MODULE is looked up on the import path and in the current folder.
        params: options of the policy, such as `desired_speed_m_s`.

    Raises:
        UsageError: unknown name or option, module that cannot be imported, missing attribute, or an object that
            is not a policy (needs `name`, `reset()` and `decide(obstacles, t_us)`).
    """
    if ":" in name:
        return _user_policy(name, params)
    known = plugins(sys.modules[__name__])
    if name not in known:
        raise UsageError(f"unknown stack {name!r}{nearest_hint(name, list(known))}: known are {', '.join(known)}; "
                         "or give your own as MODULE:NAME")
    return call_with_options("stack", name, known[name].build, params)


def _user_policy(spec: str, params: dict[str, Any]) -> Policy:
    module_name, _, attribute = spec.partition(":")
    if not module_name or not attribute:
        raise UsageError(f"stack {spec!r} is not MODULE:NAME: give both, such as my_policies:Cautious")
    target = _attribute(_import(spec, module_name), spec, attribute)
    is_instance = not isinstance(target, type) and isinstance(target, Policy)
    policy = target if is_instance else _called(spec, target, params)
    missing = [m for m in ("reset", "decide") if not callable(getattr(policy, m, None))]
    if not hasattr(policy, "name"):
        missing.insert(0, "name")
    if missing:
        raise UsageError(f"stack {spec!r} is not a policy: {type(policy).__name__} lacks {', '.join(missing)}; "
                         "it needs name, reset() and decide(obstacles, t_us)")
    return policy


def _import(spec: str, module_name: str) -> ModuleType:
    here = str(Path.cwd())
    sys.path.insert(0, here)
    try:
        return importlib.import_module(module_name)
    except ImportError as error:
        raise UsageError(f"stack {spec!r}: module {module_name!r} cannot be imported ({error}): "
                         "check the name, or run from the folder that holds it") from error
    finally:
        sys.path.remove(here)


def _attribute(module: ModuleType, spec: str, attribute: str) -> Any:
    try:
        return getattr(module, attribute)
    except AttributeError:
        public = [n for n in vars(module) if not n.startswith("_")]
        raise UsageError(f"stack {spec!r}: {module.__name__} has no {attribute!r}{nearest_hint(attribute, public)}: "
                         "name a class, a factory or an instance in it") from None


def _called(spec: str, target: Any, params: dict[str, Any]) -> Any:
    if not callable(target):
        raise UsageError(f"stack {spec!r} is not a policy: it is a {type(target).__name__}; name a class, a factory "
                         "or an instance with name, reset() and decide(obstacles, t_us)")
    try:
        return call_with_options("stack", spec, target, params)
    except TypeError as error:
        raise UsageError(f"stack {spec!r} cannot be built: {error}; its arguments must have defaults") from error
