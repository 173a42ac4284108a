"""The workflow and the image of the repository: whole, pinned, and made of what `make` runs."""

import re
import shlex
import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml
from typer.testing import CliRunner

from bench.cli import app

ROOT = Path(__file__).resolve().parent.parent.parent
WORKFLOW = ROOT / ".github" / "workflows" / "flights.yml"
ACTIONS = {
    "actions/checkout": {"fetch-depth"}, "actions/setup-python": {"python-version"},
    "actions/cache": {"path", "key", "restore-keys"}, "actions/cache/restore": {"path", "key", "restore-keys"},
    "actions/cache/save": {"path", "key"},
    "actions/upload-artifact": {"name", "path", "if-no-files-found", "retention-days"}}
TOP = {"name", "on", "permissions", "concurrency", "jobs"}
JOB = {"runs-on", "timeout-minutes", "env", "steps"}
STEP = {"name", "if", "uses", "with", "run", "env"}
EVENTS = {"push", "pull_request", "workflow_dispatch"}
TRUSTED = re.compile(r"github\.(ref|sha|event_name|event\.pull_request\.base\.sha)|env\.\w+|hashFiles\(|always\(\)")


class NoBooleans(yaml.SafeLoader):
    """YAML 1.1 reads the key `on` as true; GitHub does not."""


NoBooleans.yaml_implicit_resolvers = {
    first: [(tag, found) for tag, found in resolvers if tag != "tag:yaml.org,2002:bool"]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()}


def targets() -> set[str]:
    """Targets of the Makefile that stand for no file."""
    found = re.search(r"^\.PHONY: (.*)$", (ROOT / "Makefile").read_text(), re.M)
    assert found
    return set(found.group(1).split())


def faults_of(text: str) -> list[str]:
    """What is wrong with a workflow; empty where nothing is."""
    flow = yaml.load(text, NoBooleans)
    faults = [f"unknown key {key}" for key in flow.keys() - TOP] + [f"no {key}" for key in TOP - flow.keys()]
    faults += [f"unknown event {event}" for event in flow["on"].keys() - EVENTS]
    if flow["permissions"] != {"contents": "read"}:
        faults.append("the token may do more than read")
    for name, job in flow["jobs"].items():
        faults += [f"{name}: unknown key {key}" for key in job.keys() - JOB]
        if "timeout-minutes" not in job or "latest" in str(job["runs-on"]):
            faults.append(f"{name}: no time-out, or a runner that changes by itself")
        for step in job["steps"]:
            faults += [f"{name}: {fault}" for fault in _step_faults(step, text)]
    return faults


def _step_faults(step: dict[str, Any], text: str) -> list[str]:
    faults = [f"unknown key {key}" for key in step.keys() - STEP]
    if ("uses" in step) == ("run" in step):
        return [*faults, f"step {step} must either use an action or run something"]
    for found in [*re.findall(r"\$\{\{(.*?)\}\}", yaml.dump(step, width=10_000)), str(step.get("if", ""))]:
        names = re.findall(r"[a-z]\w*(?:\.\w+)+|\w+\(", re.sub(r"'[^']*'", "", found))
        faults += [f"expression {name} is not known here" for name in names if not TRUSTED.match(name)
                   and name not in ("always(",)]
    if "uses" in step:
        action, _, commit = step["uses"].partition("@")
        if not re.fullmatch(r"[0-9a-f]{40}", commit) or not re.search(rf"{commit} # v\d", text):
            faults.append(f"{step['uses']} is not pinned to a commit with its version beside it")
        faults += [f"{action} has no input {key}" for key in step.get("with", {}).keys() - ACTIONS.get(action, set())]
        return faults
    if "${{" in step["run"]:
        faults.append("an expression inside a script can be made to run anything: pass it by env")
    for line in step["run"].strip().splitlines():
        words = shlex.split(line)
        if words[0] != "make" or words[1] not in targets():
            faults.append(f"{line!r} is no target of the Makefile")
    return faults


def test_the_workflow_is_sound() -> None:
    assert faults_of(WORKFLOW.read_text()) == []


@pytest.mark.parametrize(("change", "words"), [
    (("actions/checkout@11bd71901bbe5b1630ceea73d27597364c9af683 # v4.2.2", "actions/checkout@v4"), "is not pinned"),
    (("make sitl", "make sittl"), "no target"), (("contents: read", "contents: write"), "more than read"),
    (("ubuntu-24.04", "ubuntu-latest"), "changes by itself"), (("retention-days", "retention-dayz"), "no input"),
    (("run: make venv", "run: make venv ${{ github.head_ref }}"), "made to run anything"),
    (("run: make kernels", "rum: make kernels"), "must either use"),
    (("timeout-minutes: 45", "timeout: 45"), "time-out"),
    (("github.event_name == 'pull_request'\n", "github.evnt_name == 'pull_request'\n"), "evnt_name is not known")])
def test_what_is_wrong_with_a_workflow_is_found(change: tuple[str, str], words: str) -> None:
    text = WORKFLOW.read_text()
    assert change[0] in text
    assert any(words in fault for fault in faults_of(text.replace(*change))), faults_of(text.replace(*change))


def steps_of_flights() -> list[str]:
    flow = yaml.load(WORKFLOW.read_text(), NoBooleans)
    return [line for step in flow["jobs"]["flights"]["steps"] for line in step.get("run", "").splitlines()]


def test_results_are_published_even_of_a_red_run() -> None:
    steps = yaml.load(WORKFLOW.read_text(), NoBooleans)["jobs"]["flights"]["steps"]
    last = steps[-1]
    assert last["uses"].startswith("actions/upload-artifact@") and last["if"] == "always()"
    assert last["with"]["path"] == "${{ env.RUNS }}"


def image_steps(text: str) -> list[list[str]]:
    """Words of every RUN that is not about system packages, and of CMD."""
    lines = text.replace("\\\n", " ").splitlines()
    found = [shlex.split(line[4:]) for line in lines if line.startswith("RUN ") and "apt-get" not in line]
    found += [[word.strip(' "') for word in line[4:].strip("[] ").split(",")] for line in lines
              if line.startswith("CMD ")]
    return found


def test_the_images_steps_are_the_ones_make_runs() -> None:
    steps = image_steps((ROOT / "Dockerfile").read_text())
    assert [words[0] for words in steps] == ["make"] * len(steps)
    assert {words[1] for words in steps} <= targets()
    ordered = list(dict.fromkeys(line.split()[1] for line in steps_of_flights()))
    assert [words[1] for words in steps] == ordered, "the image and the workflow do the same things in the same order"


def commands(target: str, *options: str) -> list[list[str]]:
    """What make would run for it, of this project's own command line."""
    said = subprocess.run(["make", "-n", "-o", ".venv/.installed", target, *options], cwd=ROOT, capture_output=True,
                          text=True, check=True).stdout
    lines = [shlex.split(line) for line in said.splitlines() if "saranga-bench " in line and "echo" not in line]
    return [words[1:] for words in lines]


@pytest.mark.parametrize(("target", "options"), [("sitl", ()), ("flights", ()), ("flights", ("BASELINE=baseline",)),
                                                 ("demo", ())])
def test_what_make_runs_are_commands_that_exist(target: str, options: tuple[str, ...]) -> None:
    found = commands(target, *options)
    assert found
    for words in found:
        name = [word for word in words[:2] if not word.startswith("-")]
        if words[0] == "fly":
            name = ["fly"]
        helped = CliRunner().invoke(app, [*name, "--help"], env={"COLUMNS": "120"})
        assert helped.exit_code == 0, helped.output
        for option in [word for word in words if word.startswith("--")]:
            assert option in helped.output, f"{' '.join(name)} has no {option}"
    assert ("--baseline" in found[0]) == bool(options)


def test_nothing_private_goes_into_the_image() -> None:
    ignored = (ROOT / ".dockerignore").read_text().split()
    assert {".git", ".venv", "runs"} <= set(ignored)
    assert not re.search(r"^(ENV|ARG) .*(TOKEN|PASSWORD|KEY)", (ROOT / "Dockerfile").read_text(), re.M)
