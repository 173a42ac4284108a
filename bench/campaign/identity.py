"""What must be the same for two sessions of one campaign: whatever can change a flight, and nothing else."""

import hashlib
from pathlib import Path
from typing import Any

from saranga.denoise.model_file import weights_sha256
from saranga.fixtures import fixture_dir

PACKAGES = ("saranga", "sitl")
FIXTURES = ("airframes", "materials", "parameters", "scenes", "shields", "sonars", "step_response")


def identity_of(denoisers: list[str], scenes: list[str]) -> dict[str, Any]:
    """Hashes of the weights, of the sources that fly, and of what they read (also of scenes given by path)."""
    return {"weights": {name: weights_sha256(name) for name in sorted(set(denoisers))},
            "sources": sources_sha256(sorted(set(scenes)))}


def sources_sha256(scenes: list[str]) -> str:
    """SHA-256 over the packages that fly, their fixtures, and those of `scenes` that are files."""
    root = Path(__file__).resolve().parent.parent.parent
    digest = hashlib.sha256()
    folders = [(root, root / package, "*.py") for package in PACKAGES]
    folders += [(fixture_dir(), fixture_dir() / name, "*") for name in FIXTURES]
    for base, folder, pattern in folders:
        for file in sorted(folder.rglob(pattern)):
            if file.is_file():
                digest.update(f"{file.relative_to(base)}\n".encode())
                digest.update(hashlib.sha256(file.read_bytes()).digest())
    for scene in scenes:
        if Path(scene).is_file():
            digest.update(hashlib.sha256(Path(scene).read_bytes()).digest())
    return digest.hexdigest()
