"""Scene files: what `fixtures/scenes/*.toml` may hold, checked once on reading."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from pydantic import Field, model_validator

from saranga.errors import UsageError
from sitl.generators import Generator, generator_from_table
from sitl.importers import scene_path, scene_tables
from sitl.shapes import Shape, shape_from_table
from sitl.validation import NotNegative, OrderedPair, OrderedRange, Positive, Table, known_key, validate

SECTIONS = ["scene", "arena", "weather", "wind", "course", "obstacle", "generator"]


class Head(Table):
    """[scene]: `paper_row` names the row of the paper's table of flights that it stands for.

    `family`: scenes of one family draw the same course from the same seed (where their other tables agree).
    """

    name: str = Field(min_length=1)
    description: str
    paper_row: str | None = None
    family: str | None = None


class Arena(Table):
    """[arena]: extent of the room from the ground up to `height_m`; `netted` walls and ceiling end a flight."""

    x_m: OrderedPair = (0.0, 11.0)
    y_m: OrderedPair = (-2.25, 2.25)
    height_m: Positive = 3.65
    netted: bool = True


class Weather(Table):
    """[weather]. Temperature, humidity and pressure set the speed and the absorption of sound.

    Fog, falling snow and light are carried for the reader and provably change no echo: at 53 kHz their effect is
    below anything measurable (the paper's sensor comparison).
    """

    temperature_c: float = Field(default=20.0, ge=-40.0, le=60.0)
    humidity_percent: float = Field(default=50.0, ge=0.0, le=100.0)
    pressure_pa: float = Field(default=101_325.0, ge=30_000.0, le=120_000.0)
    fog_extinction_per_m: NotNegative = 0.0
    snow_rate_mm_h: NotNegative = 0.0
    light_lux: NotNegative = 500.0


class Wind(Table):
    """[wind], as `sitl.physics` takes it.

    `direction_deg` is where the air goes to, from world x (0) towards y (90); `gust_m_s` is the standard
    deviation of each horizontal component, `gust_s` its time constant.
    """

    mean_m_s: float = Field(default=0.0, ge=0.0, le=30.0)
    direction_deg: float = 0.0
    gust_m_s: float = Field(default=0.0, ge=0.0, le=15.0)
    gust_s: Positive = 1.5


class CourseSpec(Table):
    """[course]: from a start drawn in `start_x_m`, `start_y_m` (a number or [smallest, largest]) to `goal_x_m`.

    `must_dodge`: a straight flight has to collide; left out, it is so where a generator draws the obstacles.
    `three_d`: the way through may lead over and under obstacles, not only past them.
    `traversability`: [smallest, largest] that a drawn course may have (`sitl.traversability`).
    """

    start_x_m: OrderedRange
    start_y_m: OrderedRange
    goal_x_m: float
    height_m: Positive = 1.0
    speed_m_s: float = Field(default=1.0, gt=0.0, le=10.0)
    timeout_s: Positive = 60.0
    must_dodge: bool | None = None
    three_d: bool = False
    traversability: OrderedPair | None = None

    @model_validator(mode="after")
    def _forward(self) -> Self:
        if self.goal_x_m <= self.start_x_m[1]:
            raise ValueError(f"goal_x_m = {self.goal_x_m:g} must lie beyond start_x_m = {self.start_x_m[1]:g}")
        return self


@dataclass(frozen=True)
class SceneSpec:
    """A scene before its seed is known. `path` is the file it came from."""

    path: Path
    head: Head
    arena: Arena
    weather: Weather
    wind: Wind
    course: CourseSpec
    obstacles: tuple[Shape, ...]
    generator: Generator | None

    @property
    def name(self) -> str:
        return self.head.name

    @property
    def must_dodge(self) -> bool:
        """Whether a straight flight has to collide."""
        asked = self.course.must_dodge
        return self.generator is not None if asked is None else asked


def load_scene(name: str) -> SceneSpec:
    """Read a scene by its name in fixtures/scenes or by path; courses of others go through `sitl.importers`.

    Raises:
        UsageError: unknown name; malformed file; unknown key, kind or material; a value of the wrong type, not
            finite or out of range. One line, with file, table, key and value.
    """
    path = scene_path(name)
    table = scene_tables(path)
    for key in table:
        known_key(key, SECTIONS, f"{path}: table")
    for key in ("scene", "arena", "course"):
        if key not in table:
            raise UsageError(f"{path}: table [{key}] is missing; compare with fixtures/scenes/poles.toml")
    spec = SceneSpec(
        path=path,
        head=validate(Head, table["scene"], f"{path}: [scene]"),
        arena=validate(Arena, table["arena"], f"{path}: [arena]"),
        weather=validate(Weather, table.get("weather", {}), f"{path}: [weather]"),
        wind=validate(Wind, table.get("wind", {}), f"{path}: [wind]"),
        course=validate(CourseSpec, table["course"], f"{path}: [course]"),
        obstacles=_shapes(table.get("obstacle", []), path),
        generator=generator_from_table(table["generator"], f"{path}: [generator]") if "generator" in table else None)
    _check_course(spec)
    return spec


def _shapes(tables: Any, path: Path) -> tuple[Shape, ...]:
    if not isinstance(tables, list):
        raise UsageError(f"{path}: write obstacles as [[obstacle]], one table each, not [obstacle]")
    return tuple(shape_from_table(table, f"{path}: [[obstacle]] {index}:") for index, table in enumerate(tables, 1))


def _check_course(spec: SceneSpec) -> None:
    """The course must lie inside the arena."""
    course, arena, path = spec.course, spec.arena, spec.path
    for key, values, (low, high), frame in (
        ("start_x_m", course.start_x_m, arena.x_m, "arena.x_m"),
        ("start_y_m", course.start_y_m, arena.y_m, "arena.y_m"),
        ("goal_x_m", (course.goal_x_m,), arena.x_m, "arena.x_m"),
        ("height_m", (course.height_m,), (0.0, arena.height_m), "0 .. arena.height_m"),
    ):
        for value in values:
            if not low < value < high:
                raise UsageError(f"{path}: [course] {key} = {value:g} must lie inside {frame} = {low:g} .. {high:g}; "
                                 "correct the file")
