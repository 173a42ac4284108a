"""Courses drawn by chance, one generator a file, found by the name of the file; each exposes its class as GENERATOR.

A generator draws; the rules that a drawing must satisfy are checked in `sitl.scene`.
"""

import importlib
import pkgutil
from functools import cache
from typing import Any

from saranga.errors import UsageError
from sitl.generators.base import Generator, GeneratorTable
from sitl.validation import known_key, validate

__all__ = ["Generator", "generator_from_table", "generator_kinds"]


@cache
def generator_kinds() -> tuple[str, ...]:
    """Every generator a scene may name, sorted."""
    return tuple(sorted(module.name for module in pkgutil.iter_modules(__path__) if module.name != "base"))


def generator_from_table(table: Any, where: str) -> Generator:
    """A generator from a scene's [generator] table.

    Raises:
        UsageError: unknown kind or key; a value of the wrong type, not finite or out of range.
    """
    if not isinstance(table, dict) or not isinstance(table.get("kind"), str):
        raise UsageError(f"{where} key 'kind' is missing or not text: allowed are {', '.join(generator_kinds())}")
    kind = table["kind"]
    known_key(kind, list(generator_kinds()), f"{where} kind")
    model: type[GeneratorTable] = importlib.import_module(f"{__name__}.{kind}").GENERATOR
    generator = validate(model, table, f"{where} ({kind})")
    assert isinstance(generator, Generator)
    return generator
