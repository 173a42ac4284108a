"""Finding the data that ships with the project: scenes, sonars, shields, airframes, parameters, limits.

In a source tree the folder is `fixtures/` beside the packages; in a wheel it is `bench/fixtures/`.
`SARANGA_FIXTURES` overrides both.
"""

import difflib
import os
import tomllib
from pathlib import Path
from typing import Any

from saranga.errors import UsageError


def fixture_dir() -> Path:
    """The folder of shipped data.

    Raises:
        UsageError: when no such folder exists.
    """
    named = os.environ.get("SARANGA_FIXTURES")
    root = Path(__file__).resolve().parent.parent
    candidates = [Path(named)] if named else [root / "fixtures", root / "bench" / "fixtures"]
    for candidate in candidates:
        if candidate.is_dir():
            return candidate
    raise UsageError(
        f"no fixtures at {', '.join(map(str, candidates))}: set SARANGA_FIXTURES to the project's fixtures folder"
    )


def fixture_names(kind: str, suffix: str = ".toml") -> list[str]:
    """Names that `fixture_path(kind, ...)` knows, sorted."""
    folder = fixture_dir() / kind
    return sorted(p.name.removesuffix(suffix) for p in folder.glob(f"*{suffix}"))


def fixture_path(kind: str, name: str, suffix: str = ".toml") -> Path:
    """Path of a fixture given its name, or of the user's own file given a path.

    Args:
        kind: folder in fixtures, such as "scenes".
        name: a shipped name ("poles") or a path ("my/scene.toml", "./x.toml").
        suffix: how files of this kind end.

    Raises:
        UsageError: unknown name (lists the known ones and the nearest) or missing file.
    """
    looks_like_path = "/" in name or name.endswith(suffix)
    if looks_like_path:
        path = Path(name).expanduser()
        if path.is_file():
            return path
        raise UsageError(f"{kind} file {name!r} does not exist: give a path to a {suffix} file or one of "
                         f"{', '.join(fixture_names(kind, suffix))}")
    shipped = fixture_dir() / kind / f"{name}{suffix}"
    if shipped.is_file():
        return shipped
    known = fixture_names(kind, suffix)
    near = difflib.get_close_matches(name, known, n=1)
    hint = f" (did you mean {near[0]!r}?)" if near else ""
    raise UsageError(f"unknown {_one_of(kind)} {name!r}{hint}: known are {', '.join(known) or 'none'}; "
                     f"or give a path to a {suffix} file")


def _one_of(kind: str) -> str:
    """"scenes" -> "scene"; "synthesis" and "training" are recipes."""
    return f"{kind} recipe" if kind in ("synthesis", "training") else kind.removesuffix("s")


def load_toml(path: Path) -> dict[str, Any]:
    """Parse a TOML file.

    Raises:
        UsageError: naming file, line and column of what is malformed.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UsageError(f"{path}: not valid TOML: {error}; mend the file and try again") from error
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror}") from error
