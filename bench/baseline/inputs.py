"""Which version of the world a run was flown in: hashes of every file that the stack cannot change."""

import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from bench.provenance import sha256_of
from saranga.errors import UsageError
from saranga.fixtures import fixture_dir, fixture_path
from sitl.acoustics.shield import shield_path
from sitl.importers import scene_path
from sitl.trial_types import TrialRequest

WORLD_FOLDERS = ("airframes", "materials", "parameters")
SIMULATOR = "simulator sources"
STACK = "stack sources"
TOLD = (SIMULATOR, STACK)
"""Differences that are told and no error: a change of the stack is what one wants to judge."""


def world_inputs(requests: Iterable[TrialRequest]) -> dict[str, str]:
    """SHA-256 by what it is of: each scene, shield and sonar asked for, airframes, materials, parameters, sources."""
    found = {}
    for request in requests:
        for kind, name, find in (("scene", request.scene, scene_path), ("shield", request.shield, shield_path),
                                 ("sonar", request.sonar, lambda name: fixture_path("sonars", name))):
            key = f"{kind} {name}"
            if key not in found:
                try:
                    found[key] = sha256_of(find(name))
                except (UsageError, OSError):  # an unknown name is reported by the trial, which knows what it needs
                    continue
    root = Path(__file__).resolve().parent.parent.parent
    found |= {folder: _folder(fixture_dir() / folder, "*") for folder in WORLD_FOLDERS}
    return found | {SIMULATOR: _folder(root / "sitl", "*.py"), STACK: _folder(root / "saranga", "*.py")}


def differences(run: Mapping[str, Any], baseline: Mapping[str, Any]) -> list[str]:
    """What both runs have and is not the same, sorted."""
    return sorted(key for key in run.keys() & baseline.keys() if run[key] != baseline[key])


def _folder(folder: Path, pattern: str) -> str:
    digest = hashlib.sha256()
    for file in sorted(folder.rglob(pattern)):
        if file.is_file():
            digest.update(f"{file.relative_to(folder)}\n".encode())
            digest.update(hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()
