"""The cache of compiled kernels follows the sources of the kernels, and never stands in the way."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = "import saranga, os; print(os.environ.get('NUMBA_CACHE_DIR', ''))"


def cache_dir(package_root: Path, home: Path, **extra: str) -> str:
    environment = {k: v for k, v in os.environ.items() if k not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")}
    environment |= {"HOME": str(home), "PYTHONPATH": str(package_root), "PYTHONDONTWRITEBYTECODE": "1", **extra}
    done = subprocess.run([sys.executable, "-c", PROGRAM], env=environment, cwd=home, capture_output=True, text=True,
                          check=True)
    return done.stdout.strip()


def copy_of_saranga(tmp_path: Path) -> Path:
    package = tmp_path / "src" / "saranga"
    package.mkdir(parents=True)
    for name in ("__init__.py", "numba_cache.py", "errors.py"):
        (package / name).write_text((ROOT / "saranga" / name).read_text())
    (tmp_path / "src" / "sitl").mkdir()
    return tmp_path / "src"


def test_a_change_of_a_kernel_or_of_what_it_imports_names_another_folder_and_no_other_change_does(
    tmp_path: Path
) -> None:
    root = copy_of_saranga(tmp_path)
    (root / "sitl" / "kernel.py").write_text("from numba import njit\n\nfrom sitl.numbers import (\n    ONE,\n)\n")
    (root / "sitl" / "numbers.py").write_text("from saranga import units\nONE = 1\n")
    (root / "saranga" / "units.py").write_text("M = 1\n")
    (root / "sitl" / "other.py").write_text("# numba is not used here\n")
    seen = [cache_dir(root, tmp_path)]
    assert seen[0].startswith(str(tmp_path / ".cache" / "saranga-bench" / "numba")) and Path(seen[0]).is_dir()
    (root / "sitl" / "other.py").write_text("# numba is not used here either\n")
    assert cache_dir(root, tmp_path) == seen[0]
    for changed in ("sitl/kernel.py", "sitl/numbers.py", "saranga/units.py"):
        with (root / changed).open("a") as file:
            file.write("x = 1\n")
        seen.append(cache_dir(root, tmp_path))
    assert len(set(seen)) == 4


def test_the_users_own_choice_stands(tmp_path: Path) -> None:
    mine = str(tmp_path / "mine")
    assert cache_dir(copy_of_saranga(tmp_path), tmp_path, NUMBA_CACHE_DIR=mine) == mine


def test_a_home_that_cannot_be_written_leaves_numbas_default(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert cache_dir(copy_of_saranga(tmp_path), tmp_path, XDG_CACHE_HOME=str(tmp_path / "file")) == ""


def test_old_folders_are_pruned(tmp_path: Path) -> None:
    root = copy_of_saranga(tmp_path)
    for number in range(9):
        (root / "sitl" / "new.py").write_text(f"import numba\nx = {'1' * number}1\n")
        cache_dir(root, tmp_path)
    assert len(list((tmp_path / ".cache" / "saranga-bench" / "numba").iterdir())) <= 6
