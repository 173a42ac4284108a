"""A drawn course as a scene file of its own: every obstacle in place, so that any seed flies the same course."""

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np

from sitl.scene import Scene
from sitl.scene_spec import SceneSpec
from sitl.shapes import shape_from_table

PLACES = (("x_m", "y_m"), ("from_m", None), ("to_m", None), ("end_a_m", None), ("end_b_m", None))


def scene_text(scene: Scene, spec: SceneSpec, name: str, description: str) -> str:
    """TOML that `sitl.scene.load_scene` reads. Wind and noise of the scene stay as they are and follow the seed."""
    start, course = scene.course.start_m, spec.course
    tables: dict[str, dict[str, Any]] = {
        "scene": {"name": name, "description": description},
        "arena": scene.arena.model_dump(mode="json"),
        "weather": scene.weather.model_dump(mode="json"),
        "wind": scene.wind.model_dump(mode="json"),
        "course": {"start_x_m": start[0], "start_y_m": start[1], "goal_x_m": course.goal_x_m,
                   "height_m": course.height_m, "speed_m_s": course.speed_m_s, "timeout_s": course.timeout_s,
                   "must_dodge": spec.must_dodge, "three_d": course.three_d},
    }
    lines: list[str] = []
    for title, table in tables.items():
        lines += [f"[{title}]", *_lines(table), ""]
    for shape in scene.obstacles:
        lines += ["[[obstacle]]", *_lines(shape.to_table()), ""]
    return "\n".join(lines)


def moved(scene: Scene, rng: np.random.Generator, step_m: float, step_deg: float, fixed: int = 0) -> Scene:
    """The same course with one to all of its drawn obstacles shifted in the plane and turned, by normal steps.

    The first `fixed` stay. Whether it can be flown is for the caller to check. Shapes without a yaw of their own are
    only shifted.
    """
    drawn = np.arange(fixed, len(scene.obstacles))
    count = int(rng.integers(1, len(drawn) + 1))
    chosen = set(rng.choice(drawn, count, replace=False).tolist())
    shapes = []
    for index, shape in enumerate(scene.obstacles):
        dx, dy, turn = (float(v) for v in rng.normal(0.0, (step_m, step_m, step_deg)))
        if index not in chosen:
            shapes.append(shape)
            continue
        table = dict(shape.to_table())
        for first, second in PLACES:
            if table.get(first) is None:
                continue
            if second is not None:
                table[first], table[second] = round(table[first] + dx, 4), round(table[second] + dy, 4)
            else:
                x, y, *rest = table[first]
                table[first] = [round(x + dx, 4), round(y + dy, 4), *rest]
        if "yaw_deg" in table:
            table["yaw_deg"] = round((table["yaw_deg"] + turn + 180.0) % 360.0 - 180.0, 2)
        shapes.append(shape_from_table(table))
    return replace(scene, obstacles=tuple(shapes))


def _lines(table: dict[str, Any]) -> list[str]:
    return [f"{key} = {_value(value)}" for key, value in table.items() if value is not None]


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        if not math.isfinite(value):
            raise ValueError(f"{value} cannot stand in a scene")
        return repr(value)
    return "[" + ", ".join(_value(v) for v in value) + "]"
