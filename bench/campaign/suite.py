"""What a campaign flies: `fixtures/campaigns/*.toml`, or the user's own file."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, model_validator

from bench.campaign.behaviour import Acceptable
from saranga.errors import UsageError
from saranga.fixtures import fixture_names, fixture_path, load_toml
from sitl.trial_types import Faults, TrialRequest
from sitl.validation import Positive, Table, validate

Rule = Literal["strict", "lenient"]


class Paper(Table):
    """What the paper printed for a row."""

    successes: int = Field(ge=0)
    trials: int = Field(ge=1)
    traversability: Positive | None = None

    @model_validator(mode="after")
    def _possible(self) -> "Paper":
        if self.successes > self.trials:
            raise ValueError(f"successes = {self.successes} of trials = {self.trials} cannot be")
        return self


class Head(Table):
    """[suite]: what every row has unless it says otherwise."""

    name: str = Field(min_length=1)
    description: str
    trials: int = Field(default=20, ge=1, le=100_000)
    seed: int = Field(default=1, ge=0)
    autopilot: Literal["embedded", "arducopter"] = "embedded"
    denoiser: str = "saranga"
    stack: str = "saranga"
    shield: str = "foam"
    sonar: str | None = None


class Row(Table):
    """[[row]]: one line of the table. `rule` says whether a touched net fails ("strict") or not ("lenient").

    `faults` are planted as by `fly --fault`; with `[row.acceptable]` the row is held to that and to no rate.
    """

    name: str = Field(min_length=1, pattern=r"^[A-Za-z0-9._-]+$")
    scene: str
    rule: Rule = "strict"
    trials: int | None = Field(default=None, ge=1, le=100_000)
    seed: int | None = Field(default=None, ge=0)
    stack: str | None = None
    denoiser: str | None = None
    shield: str | None = None
    sonar: str | None = None
    autopilot: Literal["embedded", "arducopter"] | None = None
    paper: Paper | None = None
    faults: dict[str, float | str] = Field(default_factory=dict)
    acceptable: Acceptable | None = None

    @model_validator(mode="after")
    def _one_rule(self) -> "Row":
        if self.acceptable is not None and self.paper is not None:
            raise ValueError("a row is held to the paper or to [row.acceptable], not to both")
        if self.faults and self.acceptable is None:
            raise ValueError("faults without [row.acceptable]: say what is acceptable, and why")
        return self

    @property
    def planted(self) -> Faults | None:
        """The faults of every flight of the row; None without any."""
        found = Faults.parse([f"{name}={value:g}" if isinstance(value, float | int) else f"{name}={value}"
                              for name, value in self.faults.items()])
        return found if found.any() else None


class Comparison(Table):
    """[[comparison]]: two rows flown over the same seeds.

    `expect` "regression": b must be found worse than a by what `--baseline` looks at (`bench.baseline.verdict`).
    """

    name: str
    a: str
    b: str
    rule: Rule = "strict"
    expect: Literal["a_better", "b_better", "different", "regression"] = "a_better"
    p_below: float = Field(default=0.01, gt=0.0, lt=1.0)


class Screening(Table):
    """[[screening]]: two rows flown over the same seeds, of which the fast one is to stand for the slow one."""

    name: str
    fast: str
    slow: str


@dataclass(frozen=True)
class Suite:
    """A checked suite; `path` is the file it came from."""

    path: Path
    head: Head
    rows: tuple[Row, ...]
    comparisons: tuple[Comparison, ...]
    screenings: tuple[Screening, ...] = ()

    def request(self, row: Row, seed: int) -> TrialRequest:
        """The trial of one row and seed."""
        from saranga.navigate import sonar_of

        stack = row.stack or self.head.stack
        sonar = row.sonar or self.head.sonar or sonar_of(stack) or "pair"
        return TrialRequest(scene=row.scene, seed=seed, autopilot=row.autopilot or self.head.autopilot,
                            stack=stack,
                            denoiser=row.denoiser or self.head.denoiser, shield=row.shield or self.head.shield,
                            sonar=sonar, faults=row.planted)

    def seeds(self, row: Row) -> range:
        """Seeds of a row."""
        first = self.head.seed if row.seed is None else row.seed
        return range(first, first + (row.trials or self.head.trials))

    def changed(self, rows: list[str] | None = None, trials: int | None = None, **head: Any) -> "Suite":
        """Only some rows, other trials for all of them, or other values of [suite] (None leaves one alone).

        Raises:
            UsageError: a row that the suite has not, or a value out of its limits.
        """
        values = {key: value for key, value in head.items() if value is not None}
        kept = self.rows
        if rows is not None:
            unknown = [name for name in rows if name not in {row.name for row in self.rows}]
            if unknown:
                raise UsageError(f"suite {self.head.name!r} has no row {', '.join(unknown)}: it has "
                                 f"{', '.join(row.name for row in self.rows)}")
            kept = tuple(row for row in self.rows if row.name in rows)
        if trials is not None:
            values["trials"] = trials
            kept = tuple(row.model_copy(update={"trials": None}) for row in kept)
        for key in ("denoiser", "autopilot"):
            if key in values:
                kept = tuple(row.model_copy(update={key: None}) for row in kept)
        names = {row.name for row in kept}
        return replace(self, rows=kept,
                       head=validate(Head, {**self.head.model_dump(), **values}, f"{self.path}: [suite]"),
                       comparisons=tuple(c for c in self.comparisons if {c.a, c.b} <= names),
                       screenings=tuple(c for c in self.screenings if {c.fast, c.slow} <= names))

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready; `parse_suite` reads it again."""
        return {"suite": self.head.model_dump(), "row": [_row_dict(r) for r in self.rows],
                "comparison": [c.model_dump() for c in self.comparisons],
                "screening": [c.model_dump() for c in self.screenings]}


def _row_dict(row: Row) -> dict[str, Any]:
    """As JSON has it, so that a suite read back from a journal is equal."""
    found = row.model_dump(mode="json", exclude_none=True)
    return found if row.faults else {key: value for key, value in found.items() if key != "faults"}


def load_suite(name: str) -> Suite:
    """Read a suite by its name in fixtures/campaigns or by path.

    Raises:
        UsageError: unknown name, malformed file, two rows of one name, a comparison of rows that are not there, or
            scenes, stacks, denoisers, shields or sonars that are unknown (all of them in one error).
    """
    path = fixture_path("campaigns", name)
    return parse_suite(load_toml(path), path)


def parse_suite(tables: dict[str, Any], path: Path) -> Suite:
    """Check tables as read from TOML; see `load_suite`."""
    for key in tables:
        if key not in ("suite", "row", "comparison", "screening"):
            raise UsageError(f"{path}: unknown table [{key}]: known are [suite], [[row]], [[comparison]], "
                             "[[screening]]")
    head = validate(Head, tables.get("suite"), f"{path}: [suite]")
    rows = tuple(validate(Row, table, f"{path}: [[row]] {k}") for k, table in enumerate(tables.get("row") or [], 1))
    _check_faults(rows, path)
    comparisons = tuple(validate(Comparison, table, f"{path}: [[comparison]] {k}")
                        for k, table in enumerate(tables.get("comparison") or [], 1))
    screenings = tuple(validate(Screening, table, f"{path}: [[screening]] {k}")
                       for k, table in enumerate(tables.get("screening") or [], 1))
    names = [row.name for row in rows]
    if not rows:
        raise UsageError(f"{path}: has no [[row]]: a campaign without rows would prove nothing")
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise UsageError(f"{path}: rows {', '.join(twice)} are given twice: names must differ")
    asked = [("comparison", c.name, name) for c in comparisons for name in (c.a, c.b)]
    asked += [("screening", c.name, name) for c in screenings for name in (c.fast, c.slow)]
    for kind, title, name in asked:
        if name not in names:
            raise UsageError(f"{path}: {kind} {title!r} names row {name!r}, which is not there: rows are "
                             f"{', '.join(names)}")
    suite = Suite(path, head, rows, comparisons, screenings)
    _check_names(suite)
    return suite


def _check_faults(rows: tuple[Row, ...], path: Path) -> None:
    for row in rows:
        try:
            _ = row.planted
        except UsageError as error:
            raise UsageError(f"{path}: row {row.name}: {error}") from None


def _exists(folder: str, name: str) -> bool:
    from sitl.acoustics.shield import shield_path

    if folder != "shields":
        return name in fixture_names(folder) or Path(name).is_file()
    try:
        return shield_path(name).is_file()
    except UsageError:
        return False


def _check_names(suite: Suite) -> None:
    """Everything that the rows name exists; every fault is told at once."""
    from saranga.denoise import denoiser_names
    from saranga.navigate import policy_names

    faults: list[str] = []
    known = {"denoiser": list(denoiser_names()), "stack": policy_names()}
    for row in suite.rows:
        request = suite.request(row, 0)
        for kind, folder, name in (("scene", "scenes", request.scene), ("shield", "shields", request.shield),
                                   ("sonar", "sonars", request.sonar)):
            if not _exists(folder, name):
                faults.append(f"{kind} {name!r} (row {row.name})")
        for kind, name in (("denoiser", request.denoiser), ("stack", request.stack)):
            if name not in known[kind] and ":" not in name:
                faults.append(f"{kind} {name!r} (row {row.name})")
    if faults:
        raise UsageError(f"{suite.path}: unknown {'; '.join(dict.fromkeys(faults))}: correct the suite, or give files "
                         "by path")
