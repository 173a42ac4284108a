"""Navigation policies, one file each, found by name; or the user's own as MODULE:NAME."""

import sys
from typing import Any

from saranga.errors import UsageError
from saranga.navigate.base import EchoPolicy, Policy, VelocityCommand
from saranga.plugins import call_with_options, nearest_hint, plugins, user_object, user_target

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
    if ":" not in name:
        return str(getattr(plugins(sys.modules[__name__]).get(name), "SONAR", DEFAULT_SONAR))
    try:
        target = user_target("stack", name)
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
    needs = "name, reset() and decide(obstacles, t_us)"
    policy = user_object("stack", spec, params, lambda target: isinstance(target, Policy), needs)
    missing = [m for m in ("reset", "decide") if not callable(getattr(policy, m, None))]
    if not hasattr(policy, "name"):
        missing.insert(0, "name")
    if missing:
        raise UsageError(f"stack {spec!r} is not a policy: {type(policy).__name__} lacks {', '.join(missing)}; "
                         f"it needs {needs}")
    return policy
