"""Tables of a TOML file into checked models, with errors a person can act on: one line, one first fault."""

import difflib
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from saranga.errors import UsageError

Model = TypeVar("Model", bound=BaseModel)


class Table(BaseModel):
    """A TOML table: nothing unknown, nothing converted, nothing that is not finite, never changed afterwards."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


def _tuple(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


def _range(value: Any) -> Any:
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return (value, value)
    return _tuple(value)


def _ordered(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] > value[1]:
        raise ValueError("must be [smallest, largest]")
    return value


Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Pair = Annotated[tuple[float, float], BeforeValidator(_tuple)]
Triple = Annotated[tuple[float, float, float], BeforeValidator(_tuple)]
OrderedPair = Annotated[tuple[float, float], BeforeValidator(_tuple), AfterValidator(_ordered)]
"""[smallest, largest]."""
OrderedRange = Annotated[tuple[float, float], BeforeValidator(_range), AfterValidator(_ordered)]
"""[smallest, largest], or one number for both."""


def validate(model: type[Model], table: Any, where: str) -> Model:
    """Check one table.

    Args:
        model: what it must look like.
        table: as the TOML parser gives it.
        where: file and table for the message, such as "fixtures/scenes/x.toml: [arena]".

    Raises:
        UsageError: one line with the key, its value and what is allowed; further faults are counted.
    """
    if not isinstance(table, dict):
        raise UsageError(f"{where} must be a table of keys and values, not {type(table).__name__}; correct the file")
    try:
        return model.model_validate(table)
    except ValidationError as error:
        faults = error.errors(include_url=False)
        # An unknown key is most often the misspelt one that is then missing: name it first.
        faults.sort(key=lambda fault: fault["type"] != "extra_forbidden")
        more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
        raise UsageError(f"{where} {_sentence(model, dict(faults[0]))}{more}; correct the file") from None


def known_key(key: str, known: list[str], where: str) -> None:
    """Check that `key` is one of `known`.

    Raises:
        UsageError: it is not; names the known ones and the nearest.
    """
    if key not in known:
        raise UsageError(f"{where} {_unknown(key, known)}; correct the file")


def _unknown(key: str, known: list[str]) -> str:
    near = difflib.get_close_matches(key, known, n=1)
    hint = f" (did you mean {near[0]!r}?)" if near else ""
    return f"{key!r} is not known{hint}: allowed are {', '.join(known)}"


def _sentence(model: type[BaseModel], fault: dict[str, Any]) -> str:
    head, *rest = [*fault["loc"], ""][:-1] or [""]
    key = str(head) + "".join(f"[{part}]" for part in rest if isinstance(part, int))
    if fault["type"] == "extra_forbidden":
        return f"key {_unknown(key, list(model.model_fields))}"
    if fault["type"] == "missing":
        return f"key {key!r} is missing"
    allowed = fault["msg"].removeprefix("Value error, ").replace("Input should be", "must be")
    return f"{key} = {fault['input']!r}: {allowed}" if key else allowed
