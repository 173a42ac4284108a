"""Where compiled kernels are kept.

Numba notices a change in a cached function's own file, but not in a jitted function that it calls from another
file: it would then go on running the old code. So the cache folder is named by every source file there is, and a
change anywhere compiles anew (about half a minute, once).
"""

import contextlib
import hashlib
import os
import shutil
from pathlib import Path

PACKAGES = ("saranga", "sitl", "bench")
KEPT = 6


def use_own_cache() -> None:
    """Point numba at `~/.cache/saranga-bench/numba/<state of the sources>` unless NUMBA_CACHE_DIR says otherwise.

    Must run before numba is imported. Where the folder cannot be made numba keeps to its default.
    """
    if "NUMBA_CACHE_DIR" in os.environ:
        return
    root = Path(__file__).resolve().parent.parent
    state = hashlib.sha256(str(root).encode())
    for package in PACKAGES:
        for source in sorted((root / package).rglob("*.py")):
            stat = source.stat()
            state.update(f"{source}:{stat.st_mtime_ns}:{stat.st_size}\n".encode())
    caches = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "saranga-bench" / "numba"
    folder = caches / state.hexdigest()[:16]
    try:
        if not folder.is_dir():
            folder.mkdir(parents=True, exist_ok=True)
            _prune(caches)
        else:
            os.utime(folder)
    except OSError:
        return
    os.environ["NUMBA_CACHE_DIR"] = str(folder)


def is_cold() -> bool:
    """Whether nothing has been compiled yet for this state of the sources."""
    folder = os.environ.get("NUMBA_CACHE_DIR")
    return folder is not None and next(Path(folder).rglob("*.nbi"), None) is None


def _prune(caches: Path) -> None:
    """Keep the few newest: older ones belong to sources that are gone."""
    folders = sorted((f for f in caches.iterdir() if f.is_dir()), key=lambda f: f.stat().st_mtime, reverse=True)
    for old in folders[KEPT:]:
        with contextlib.suppress(OSError):
            shutil.rmtree(old)
