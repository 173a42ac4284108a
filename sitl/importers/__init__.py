"""Courses of others, one format a file, found by looking at what the file holds.

An importer is a module with `FORMAT` (what to call it), `accepts(data)` and `scene_tables(data, path)`, which gives the
tables of a scene file; from there on the course is checked and flown like any scene.
"""

import importlib
import json
import pkgutil
from pathlib import Path
from typing import Any

import yaml

from saranga.errors import UsageError
from saranga.fixtures import fixture_path, load_toml

__all__ = ["scene_path", "scene_tables"]

SUFFIXES = (".yaml", ".yml", ".json")
LARGEST_BYTES = 4_000_000


def scene_path(name: str) -> Path:
    """The file of a scene: a name in fixtures/scenes, or a path to a scene (.toml) or a course of others.

    Raises:
        UsageError: there is none.
    """
    path = Path(name).expanduser()
    if path.suffix.lower() not in SUFFIXES:
        return fixture_path("scenes", name)
    if not path.is_file():
        raise UsageError(f"course file {name!r} does not exist: give the path of an Aerialist test (.yaml) or a "
                         "RotorPy world (.json)")
    return path


def scene_tables(path: Path) -> dict[str, Any]:
    """The tables of a scene file, or of a course made into one.

    Raises:
        UsageError: malformed, or no format that is known; one line with file, key and value.
    """
    if path.suffix.lower() not in SUFFIXES:
        return load_toml(path)
    data = _parse(path)
    formats = [importlib.import_module(f"{__name__}.{m.name}") for m in pkgutil.iter_modules(__path__)]
    formats = [module for module in formats if hasattr(module, "FORMAT")]
    if isinstance(data, dict):
        for module in formats:
            if module.accepts(data):
                tables: dict[str, Any] = module.scene_tables(data, path)
                return tables
    top = f"its keys are {', '.join(map(str, data))}" if isinstance(data, dict) else f"it is a {type(data).__name__}"
    raise UsageError(f"{path}: not a course: {top[:200]}; known are {', '.join(m.FORMAT for m in formats)}")


def _parse(path: Path) -> Any:
    try:
        if path.stat().st_size > LARGEST_BYTES:
            raise UsageError(f"{path}: larger than {LARGEST_BYTES} bytes: not a course")
        text = path.read_text(encoding="utf-8-sig")
        return json.loads(text) if path.suffix.lower() == ".json" else yaml.safe_load(text)
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror}") from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        what = " ".join(str(error).split())
        raise UsageError(f"{path}: not valid {path.suffix[1:]}: {what}; mend the file and try again") from error
