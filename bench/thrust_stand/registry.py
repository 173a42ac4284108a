"""Stands and throttles by URL: `DRIVER+TRANSPORT:REST?OPTION=VALUE&...`. A driver is a module of `drivers`.

A driver module has `NAME` (what stands before "+" or ":"), `FORMS` (its URLs, for people), `MEASURES` and `SPINS`
(whether what it builds is a ThrustStand, a ThrottleOutput or both), and `build(where, **options)`. Nothing is
connected before `open`. A device that measures and spins is one object: `open_stand(url)` serves as both.
"""

import functools
import re
from dataclasses import dataclass
from types import ModuleType
from typing import Any
from urllib.parse import parse_qsl, urlsplit

from bench.thrust_stand import drivers
from bench.thrust_stand.protocol import ThrottleOutput, ThrustStand
from saranga.errors import UsageError
from saranga.plugins import call_with_options, nearest_hint, plugins

SCHEME = re.compile(r"([a-z][a-z0-9]*)(?:\+([a-z][a-z0-9]*))?:(.*)", re.DOTALL)
ALIASES = {"serial": "teensy", "tcp": "teensy"}
"""The plain URLs of a rig: its stand speaks the same protocol."""


@dataclass(frozen=True)
class Where:
    """A URL taken apart. `path` is a serial port or file; `host` and `port` are those of tcp and udp."""

    url: str
    driver: str
    transport: str = ""
    path: str = ""
    host: str = ""
    port: int = 0

    def refused(self, forms: str) -> UsageError:
        """For a driver that does not understand it."""
        return UsageError(f"stand URL {self.url!r} is not understood: use {forms}")


def driver_modules() -> dict[str, ModuleType]:
    """Drivers by name."""
    return plugins(drivers)


def open_stand(url: str) -> ThrustStand:
    """The stand that a URL names; it connects when its `open` is called.

    Raises:
        UsageError: an unknown driver or option, a malformed URL, or a driver that measures nothing.
    """
    module, built = _built(url)
    if not module.MEASURES:
        raise UsageError(f"stand URL {url!r}: {module.NAME} only spins, it measures nothing: use it as the throttle, "
                         f"with {_able('MEASURES')} as the stand")
    stand: ThrustStand = built
    return stand


def open_throttle(url: str) -> ThrottleOutput:
    """The throttle that a URL names; it connects when its `open` is called.

    Raises:
        UsageError: an unknown driver or option, a malformed URL, or a driver that spins nothing.
    """
    module, built = _built(url)
    if not module.SPINS:
        raise UsageError(f"throttle URL {url!r}: {module.NAME} only measures, it spins nothing: use one of "
                         f"{_able('SPINS')}")
    throttle: ThrottleOutput = built
    return throttle


def _built(url: str) -> tuple[ModuleType, Any]:
    where, options = parse_url(url)
    modules = driver_modules()
    if where.driver not in modules:
        raise UsageError(f"stand URL {url!r}: unknown driver {where.driver!r}"
                         f"{nearest_hint(where.driver, list(modules))}: known are {', '.join(modules)}")
    module = modules[where.driver]
    factory = functools.partial(module.build, where)
    return module, call_with_options("stand driver", where.driver, factory, options)


def _able(what: str) -> str:
    return ", ".join(name for name, module in driver_modules().items() if getattr(module, what))


def parse_url(url: str) -> tuple[Where, dict[str, Any]]:
    """The parts of a URL and its options, numbers as numbers.

    Raises:
        UsageError: it is malformed.
    """
    match = SCHEME.fullmatch(url.strip())
    if match is None:
        forms = "; ".join(module.FORMS for module in driver_modules().values())
        raise UsageError(f"stand URL {url!r}: no driver before a colon: use {forms}")
    driver, transport, rest = match[1], match[2] or "", match[3]
    if driver in ALIASES and not transport:
        driver, transport = ALIASES[driver], driver
    rest, _, query = rest.partition("?")
    try:
        # A plus is a plus here (regular expressions have them), not a blank.
        options = parse_qsl(query.replace("+", "%2B"), keep_blank_values=True, strict_parsing=bool(query))
        parts = urlsplit(f"x:{rest}" if transport in ("tcp", "udp") else "")
        host, port = parts.hostname or "", parts.port or 0
    except ValueError as error:
        raise UsageError(f"stand URL {url!r}: {error}") from error
    twice = [name for k, (name, _) in enumerate(options) if name in dict(options[:k])]
    if twice:
        raise UsageError(f"stand URL {url!r}: option {twice[0]!r} is given twice")
    path = rest.removeprefix("//") if transport not in ("tcp", "udp") else ""
    return Where(url, driver, transport, path, host, port), {name: _value(text) for name, text in options}


def _value(text: str) -> int | float | str:
    for kind in (int, float):
        try:
            value: int | float = kind(text)
        except ValueError:
            continue
        return value
    return text
