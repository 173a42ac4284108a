"""The contract as a user runs it: what ships passes, what is spoilt fails where it is spoilt."""

import os
import re
import sys
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
from bad_subjects import FOUND_BY

from bench.contract import echoes
from bench.contract.subject import DENOISER, POLICY, Subject, find_subjects
from saranga.denoise import denoiser_names
from saranga.errors import UsageError
from saranga.navigate import policy_names

pytest_plugins = ["pytester"]
HERE = Path(__file__).parent
PLAIN = ("-p", "no:cacheprovider", "-p", "no:benchmark", "-p", "no:hypothesispytest", "-p", "no:xdist")
# A busy machine is slower, but no result may hang on how much.
NO_TIMES = ("-k", "not quick_enough")


@pytest.fixture
def run(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("PYTEST_ADDOPTS", raising=False)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(HERE), os.environ.get("PYTHONPATH", "")]))

    def run_contract(*arguments: str) -> pytest.RunResult:
        return pytester.runpytest_subprocess(*PLAIN, *arguments, timeout=200)

    return run_contract


def of(*names: str) -> list[str]:
    return [f"--bench-contract={name}" for name in names]


def test_what_ships_passes_and_only_the_contract_is_run(run, pytester: pytest.Pytester) -> None:
    pytester.makepyfile("def test_of_the_users_own_suite(): assert False")
    result = run(*of("gaussian", "none", "batdeck"), *NO_TIMES)
    assert result.ret == 0, result.stdout.str()
    outcomes = result.parseoutcomes()
    assert outcomes["passed"] > 40 and outcomes.get("skipped") == 1, "only `none` reads no images"
    result.stdout.fnmatch_lines([
        "bench contract: gaussian is a denoiser", "bench contract: none is a policy", "bench contract: batdeck is a *"])


def test_paths_that_are_typed_are_run_as_well(run, pytester: pytest.Pytester) -> None:
    own = pytester.makepyfile("def test_of_the_users_own_suite(): assert False")
    result = run(*of("none"), "-k", "is_a_policy or own_suite", str(own))
    result.assert_outcomes(passed=1, failed=1, deselected=result.parseoutcomes()["deselected"])


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted({*denoiser_names(), *policy_names()}))
def test_everything_that_ships_passes(run, name: str) -> None:
    result = run(*of(name))
    text = result.stdout.str()
    if "not installed" in text or "cannot be imported" in text:
        pytest.skip(f"{name}: its runtime is not installed here")
    assert result.ret == 0, text


def test_every_spoilt_one_fails_where_it_is_spoilt(run) -> None:
    """And some, whose one fault shows in one place, nowhere else: a dozen failures for one cause would name nothing."""
    result = run(*of(*(f"bad_subjects:{name}" for name in FOUND_BY)), "-rf", "--tb=no")
    failed = defaultdict(set)
    for line in result.stdout.lines:
        match = re.match(r"FAILED \S*::(.*?\[.*)\w+=bad_subjects:(\w+)(.*)", line)
        if match is not None:
            failed[match.group(2)].add(match.group(1) + match.group(3))
    missed = {name: (want, sorted(failed[name])) for name, want in FOUND_BY.items()
              if not any(want in found for found in failed[name])}
    assert not missed, f"what should have found it, and what did: {missed}"
    assert result.ret == 1
    for name in ("Float64", "Scribbles", "Remembers", "Empties", "SlowPolicy"):
        others = [found for found in failed[name] if FOUND_BY[name] not in found and "quick_enough" not in found]
        assert not others, f"{name} fails {others} as well"


def test_a_name_that_is_nothing_says_what_there_is(run) -> None:
    result = run(*of("no-such-thing"))
    assert result.ret == 4
    result.stderr.fnmatch_lines(["*--bench-contract no-such-thing: no denoiser (*gaussian*) and no stack (*none*"])


def test_it_tells_which_of_the_two_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "bad_subjects", __import__("bad_subjects"))
    assert find_subjects(["saranga"]) == [Subject(DENOISER, "saranga"), Subject(POLICY, "saranga")]
    assert find_subjects(["bad_subjects:Slow", "bad_subjects:Draws", "tbd", "tbd"]) == [
        Subject(DENOISER, "bad_subjects:Slow"), Subject(POLICY, "bad_subjects:Draws"), Subject(DENOISER, "tbd")]
    with pytest.raises(UsageError, match="neither a denoiser nor a policy"):
        find_subjects(["bad_subjects:FOUND_BY"])


def test_the_made_up_echoes_are_what_they_say() -> None:
    image = echoes.pole_image()
    row = image.envelope[-1]
    assert abs(int(np.argmax(row)) * echoes.COLUMN_M - echoes.POLE_M) < 0.1 and image.rows == 32
    assert np.isnan(echoes.broken_image().envelope).any()
    lost = echoes.pole_image(lost=[5]).envelope
    assert not lost[5].any() and lost[6].any()
    assert echoes.constant_image(32767).envelope[-1, 50:300].min() > 1.0
