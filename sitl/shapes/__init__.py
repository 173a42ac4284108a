"""Kinds of obstacle, one file each, found by the name of the file; each file exposes its class as SHAPE."""

import importlib
import pkgutil
from functools import cache
from typing import Any

from saranga.errors import UsageError
from sitl.shapes.base import Shape, ShapeTable
from sitl.validation import known_key, validate

__all__ = ["Shape", "shape_from_table", "shape_kinds"]


@cache
def shape_kinds() -> tuple[str, ...]:
    """Every kind a scene may name, sorted."""
    return tuple(sorted(module.name for module in pkgutil.iter_modules(__path__) if module.name != "base"))


def shape_from_table(table: dict[str, Any], where: str = "obstacle:") -> Shape:
    """A shape from a table with `kind` and that kind's own keys.

    Args:
        table: as in a scene's [[obstacle]].
        where: file and table, for the message.

    Raises:
        UsageError: unknown kind, key or material; a value of the wrong type, not finite or out of range.
    """
    if not isinstance(table, dict) or not isinstance(table.get("kind"), str):
        raise UsageError(f"{where} key 'kind' is missing or not text: allowed are {', '.join(shape_kinds())}")
    kind = table["kind"]
    known_key(kind, list(shape_kinds()), f"{where} kind")
    model: type[ShapeTable] = importlib.import_module(f"{__name__}.{kind}").SHAPE
    shape = validate(model, table, f"{where[:-1] if where.endswith(':') else where} ({kind}):")
    shape.check_material(where)
    assert isinstance(shape, Shape)
    return shape
