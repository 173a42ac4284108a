"""What must be the same for two sessions of one campaign: whatever can change a flight, and nothing else."""

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from saranga.denoise.model_file import weights_sha256
from saranga.fixtures import fixture_dir
from sitl.acoustics.shield import shield_path
from sitl.trial_types import TrialRequest

PACKAGES = ("saranga", "sitl")
FIXTURES = ("airframes", "materials", "parameters", "scenes", "shields", "sonars", "step_response")


def identity_of(requests: Sequence[TrialRequest]) -> dict[str, Any]:
    """Hashes of the weights, of the sources that fly, and of what they read (also of files given by path)."""
    files = {str(path) for request in requests for path in _read_by(request)}
    return {"weights": {name: weights_sha256(name) for name in sorted({one.denoiser for one in requests})},
            "sources": sources_sha256(sorted(files))}


def _read_by(request: TrialRequest) -> list[Path]:
    """Scene, shield and sonar, as far as they are files."""
    named = [Path(name).expanduser() for name in (request.scene, request.sonar) if name]
    return [path for path in [*named, shield_path(request.shield)] if path.is_file()]


def sources_sha256(files: list[str]) -> str:
    """SHA-256 over the packages that fly, their fixtures, and `files`."""
    root = Path(__file__).resolve().parent.parent.parent
    digest = hashlib.sha256()
    folders = [(root, root / package, "*.py") for package in PACKAGES]
    folders += [(fixture_dir(), fixture_dir() / name, "*") for name in FIXTURES]
    for base, folder, pattern in folders:
        for one in sorted(folder.rglob(pattern)):
            if one.is_file():
                digest.update(f"{one.relative_to(base)}\n".encode())
                digest.update(hashlib.sha256(one.read_bytes()).digest())
    for file in files:
        digest.update(hashlib.sha256(Path(file).read_bytes()).digest())
    return digest.hexdigest()
