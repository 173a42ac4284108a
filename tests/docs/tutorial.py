"""Runs the console blocks of a page: commands after "$ ", and below them what they must print.

Numbers and run folders stand for any; a line "..." for anything; "..." at a line's end for the rest of it. A command
ends with "# exit N" where it must not end with 0. Blocks whose first line is "# file NAME" are written before.
"""

import os
import re
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
RUN = re.compile(r"\d{8}T\d{6}Z-([a-z-]+)-[0-9a-f]{6}")
NUMBER = re.compile(r"[-+]?\d+(\.\d+)?(e[-+]?\d+)?")
COMMAND_S = 300.0


@dataclass
class Command:
    text: str
    exit_code: int = 0
    expected: list[str] = field(default_factory=list)


def steps(page: Path) -> list[Command | tuple[str, str]]:
    """Commands and files (name, text) of a page in order."""
    found: list[Command | tuple[str, str]] = []
    for language, body in FENCE.findall(page.read_text(encoding="utf-8")):
        name = re.match(r"# file (\S+)\n", body)
        if name:
            found.append((name[1], body))
        elif language == "console":
            found += _commands(body)
    return found


def _commands(body: str) -> list[Command]:
    commands: list[Command] = []
    for line in body.replace("\\\n", " ").splitlines():
        if line.startswith("$ "):
            text, _, wanted = line[2:].partition("# exit ")
            commands.append(Command(text.strip(), int(wanted or 0)))
        elif line.strip():
            commands[-1].expected.append(line)
    return commands


def masked(line: str) -> str:
    """The line with numbers, run names and spacing alike."""
    return " ".join(NUMBER.sub("#", RUN.sub(r"RUN-\1", line)).split())


def missing(expected: list[str], printed: str) -> str | None:
    """The first expected line that is not printed, in order; None when all are."""
    lines = iter(masked(line) for line in printed.splitlines())
    for want in expected:
        if want.strip() == "...":
            continue
        text = masked(want)
        if text.endswith("..."):
            text = text[:-3].rstrip()
            if not any(line.startswith(text) for line in lines):
                return want
        elif text not in lines:
            return want
    return None


def run(page: Path, folder: Path) -> int:
    """Execute a page in `folder`; returns how many commands it has.

    Raises:
        AssertionError: the first command that fails, with what it printed.
    """
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
                   "COLUMNS": "160", "NO_COLOR": "1"}
    for name in ("SARANGA_BENCH_RUNS", "PYTEST_ADDOPTS", "GITHUB_STEP_SUMMARY"):
        environment.pop(name, None)
    commands = 0
    for step in steps(page):
        if isinstance(step, tuple):
            (folder / step[0]).write_text(step[1], encoding="utf-8")
            continue
        commands += 1
        done = subprocess.run(["bash", "-c", step.text], cwd=folder, env=environment, stdin=subprocess.DEVNULL,
                              stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=COMMAND_S)
        told = f"{page.name}: $ {step.text}\n{done.stdout[-4000:]}"
        assert done.returncode == step.exit_code, f"exit {done.returncode}, not {step.exit_code}: {told}"
        line = missing(step.expected, done.stdout)
        assert line is None, f"it never prints {line!r}: {told}"
    return commands
