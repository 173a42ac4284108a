"""ArduPilot parameter sets: both spellings written, the spelling that the running firmware knows read back."""

from dataclasses import dataclass
from pathlib import Path

from saranga.errors import UsageError
from saranga.fixtures import fixture_path, load_toml


@dataclass(frozen=True)
class Parameter:
    """One setting in the names of ArduCopter 4.7 and of 4.5/4.6."""

    name: str
    value: float
    why: str
    name_v45: str
    value_v45: float

    def spelling(self, version: tuple[int, int]) -> tuple[str, float]:
        """Name and value for the firmware `version` (major, minor)."""
        return (self.name, self.value) if version >= (4, 7) else (self.name_v45, self.value_v45)


def load_parameters(name: str) -> list[Parameter]:
    """Read `fixtures/parameters/NAME.toml` (or a path).

    Raises:
        UsageError: malformed file, missing value or reason, or a name ArduPilot cannot carry (over 16 characters).
    """
    path = fixture_path("parameters", name)
    parameters = []
    for key, table in load_toml(path).items():
        try:
            other = table.get("v45", {})
            parameters.append(Parameter(key, float(table["value"]), str(table["why"]),
                                        str(other.get("name", key)), float(other.get("value", table["value"]))))
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise UsageError(f"{path}: parameter {key}: needs a number `value` and a reason `why` "
                             f"({error!r})") from error
        if len(key) > 16 or len(parameters[-1].name_v45) > 16:
            raise UsageError(f"{path}: parameter {key}: ArduPilot names have at most 16 characters")
    return parameters


def write_defaults(parameters: list[Parameter], path: Path) -> None:
    """Write a file for `--defaults` with both spellings."""
    lines = []
    for p in parameters:
        lines.append(f"{p.name} {p.value:g}")
        if p.name_v45 != p.name:
            lines.append(f"{p.name_v45} {p.value_v45:g}")
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


def mismatches(parameters: list[Parameter], version: tuple[int, int], answered: dict[str, float]) -> list[str]:
    """What reads back differently from what was asked, one line each; a parameter that never answered is a mismatch."""
    wrong = []
    for p in parameters:
        name, wanted = p.spelling(version)
        got = answered.get(name)
        if got is None:
            wrong.append(f"{name}: no answer (wanted {wanted:g}); this firmware may not know it")
        elif not abs(got - wanted) <= 1e-4 * max(1.0, abs(wanted)):
            wrong.append(f"{name}: reads {got:g}, wanted {wanted:g}")
    return wrong
