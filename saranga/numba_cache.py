"""Where compiled kernels are kept.

Numba notices a change in a cached function's own file, but not in a jitted function that it calls from another
file, nor in a constant that it takes from there: it would then go on running the old code. So the cache folder is
named by every source file that has kernels and by all that these import, and a change in any of them compiles anew
(about a minute, once).
"""

import contextlib
import hashlib
import os
import re
import shutil
from pathlib import Path

PACKAGES = ("saranga", "sitl", "bench")
KEPT = 6
KERNELS = re.compile(rb"^(?:from|import) numba\b", re.MULTILINE)
IMPORTED = re.compile(rb"^(?:from|import)\s+((?:saranga|sitl|bench)[\w.]*)(?: import (?:\(([\w\s,]*)|([\w ,]*)))?",
                      re.MULTILINE)


def use_own_cache() -> None:
    """Point numba at `~/.cache/saranga-bench/numba/<state of the sources>` unless NUMBA_CACHE_DIR says otherwise.

    Must run before numba is imported. Where the folder cannot be made numba keeps to its default.
    """
    if "NUMBA_CACHE_DIR" in os.environ:
        return
    root = Path(__file__).resolve().parent.parent
    state = hashlib.sha256(str(root).encode())
    for source in kernel_sources(root):
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


def kernel_sources(root: Path) -> list[Path]:
    """Source files under `root` that use numba, and those they import at their top, directly or not."""
    texts = {path: path.read_bytes() for package in PACKAGES for path in (root / package).rglob("*.py")}
    found: set[Path] = set()
    waiting = [path for path, text in texts.items() if KERNELS.search(text)]
    while waiting:
        path = waiting.pop()
        if path in found:
            continue
        found.add(path)
        for module, *names in IMPORTED.findall(texts[path]):
            base = root.joinpath(*module.decode().split("."))
            parts = [base, *(base / name.split()[0] for name in b",".join(names).decode().split(",") if name.strip())]
            waiting += [file for part in parts for file in (part.with_suffix(".py"), part / "__init__.py")
                        if file in texts]
    return sorted(found)


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
