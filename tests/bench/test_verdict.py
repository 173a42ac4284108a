"""Verdicts fail closed: what is missing, wrong or too little never passes."""

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.verdict import Limit, Measurement, Verdict, check, check_rate, find_limits, load_limits, worst
from saranga.errors import UsageError

WHY = {"reason": "because", "source": "somewhere"}
VERDICTS = st.sampled_from(Verdict)
FLOATS = st.floats(-1e6, 1e6)


def limit(**values: object) -> Limit:
    return Limit(**({"name": "thing", "unit": "m", "lo": 1.0, **WHY} | values))  # type: ignore[arg-type]


def rate_limit(**values: object) -> Limit:
    return limit(**({"name": "success_rate_strict", "unit": "1", "lo": 0.6} | values))


def test_exit_codes_are_the_contract() -> None:
    assert {v.value: v.exit_code for v in Verdict} == {
        "PASS": 0,
        "MARGINAL": 0,
        "FAIL": 1,
        "INCONCLUSIVE": 3,
        "ERROR": 4,
    }


def test_nothing_is_inconclusive() -> None:
    assert worst([]) is Verdict.INCONCLUSIVE


@given(st.lists(VERDICTS, min_size=1))
def test_an_error_is_never_hidden_and_a_pass_needs_all(verdicts: list[Verdict]) -> None:
    got = worst(verdicts)
    assert got in verdicts
    assert (got is Verdict.ERROR) == (Verdict.ERROR in verdicts)
    assert (got is Verdict.PASS) == all(v is Verdict.PASS for v in verdicts)
    assert got.accepted == all(v.accepted for v in verdicts)


@given(st.lists(VERDICTS), VERDICTS)
def test_more_evidence_never_improves_a_verdict(verdicts: list[Verdict], another: Verdict) -> None:
    order = [Verdict.PASS, Verdict.MARGINAL, Verdict.INCONCLUSIVE, Verdict.FAIL, Verdict.ERROR]
    if verdicts:
        assert order.index(worst([*verdicts, another])) >= order.index(worst(verdicts))


@pytest.mark.parametrize("value", [None, math.nan, math.inf, -math.inf, True])
def test_no_number_is_an_error_even_for_a_limit_that_any_number_meets(value: float | None) -> None:
    got = check(Measurement(value, "m"), limit(lo=-1e300))
    assert got.verdict is Verdict.ERROR
    assert got.to_dict()["value"] in (None, True)


def test_no_measurement_at_all_is_an_error() -> None:
    assert check(None, limit()).verdict is Verdict.ERROR


@given(FLOATS, FLOATS, FLOATS)
def test_pass_means_inside_the_bounds(value: float, a: float, b: float) -> None:
    low, high = sorted((a, b))
    got = check(Measurement(value, "m"), limit(lo=low, hi=high)).verdict
    assert got is (Verdict.PASS if low <= value <= high else Verdict.FAIL)


@given(FLOATS, st.sampled_from(["mm", "", "M"]))
def test_another_unit_never_passes(value: float, unit: str) -> None:
    assert check(Measurement(value, unit), limit(lo=-1e9)).verdict is Verdict.ERROR


@given(FLOATS, st.integers(0, 4))
def test_too_few_samples_never_pass(value: float, samples: int) -> None:
    assert (
        check(Measurement(value, "m", samples=samples), limit(lo=-1e9, min_samples=5)).verdict is Verdict.INCONCLUSIVE
    )


@given(FLOATS, st.text(max_size=9).filter(lambda t: t != "measured"))
def test_simulated_never_passes_where_measured_is_asked_for(value: float, origin: str) -> None:
    wants = limit(lo=-1e9, requires="measured")
    assert check(Measurement(value, "m", origin), wants).verdict is Verdict.INCONCLUSIVE
    assert check(Measurement(value, "m", "measured"), wants).verdict is Verdict.PASS


def test_marginal_band() -> None:
    held_to = limit(lo=1.0, marginal_lo=2.0, marginal_hi=8.0, hi=9.0)
    got = [check(Measurement(v, "m"), held_to).verdict.value for v in (0.9, 1.0, 2.0, 8.0, 8.5, 9.1)]
    assert got == ["FAIL", "MARGINAL", "PASS", "PASS", "MARGINAL", "FAIL"]


@pytest.mark.parametrize(
    ("successes", "trials", "verdict"),
    [
        (0, 0, "INCONCLUSIVE"),
        (3, 3, "INCONCLUSIVE"),  # 44 % to 100 %
        (6, 6, "PASS"),  # from 61 %
        (10, 10, "PASS"),
        (9, 10, "INCONCLUSIVE"),  # from 59.6 %
        (2, 10, "FAIL"),  # up to 51 %
        (0, 10, "FAIL"),
    ],
)
def test_rate_is_judged_by_its_interval(successes: int, trials: int, verdict: str) -> None:
    got = check_rate(successes, trials, rate_limit())
    assert got.verdict.value == verdict
    assert (got.trials_needed == 0) == (verdict in ("PASS", "FAIL"))


def test_rate_not_below_the_limit_but_below_the_reference_is_marginal() -> None:
    assert check_rate(75, 100, rate_limit(marginal_lo=0.81)).verdict is Verdict.MARGINAL
    assert check_rate(85, 100, rate_limit(marginal_lo=0.81)).verdict is Verdict.PASS


def test_rate_with_too_few_or_simulated_trials_is_inconclusive() -> None:
    few = check_rate(10, 10, rate_limit(min_samples=20))
    assert (few.verdict, few.trials_needed) == (Verdict.INCONCLUSIVE, 10)
    assert check_rate(10, 10, rate_limit(requires="measured")).verdict is Verdict.INCONCLUSIVE
    assert check_rate(10, 10, rate_limit(requires="measured"), "measured").verdict is Verdict.PASS


def test_a_rate_without_its_counts_never_passes() -> None:
    assert check(Measurement(1.0, "1"), rate_limit()).verdict is Verdict.INCONCLUSIVE


@given(st.integers(0, 300), st.data())
def test_no_rate_passes_whose_own_value_is_below_the_limit(trials: int, data: st.DataObject) -> None:
    successes = data.draw(st.integers(0, trials))
    got = check_rate(successes, trials, rate_limit()).verdict
    if not trials or successes / trials < 0.6:
        assert not got.accepted
    else:
        assert got is not Verdict.FAIL


@pytest.mark.parametrize(
    "values",
    [
        {"lo": None},
        {"lo": math.nan},
        {"lo": math.inf},
        {"lo": 2.0, "hi": 1.0},
        {"marginal_lo": 0.5},
        {"reason": " "},
        {"source": ""},
        {"requires": "guessed"},
        {"min_samples": 0},
        {"confidence": 1.0},
        {"name": "success_rate", "lo": 1.0},
        {"name": "success_rate", "lo": 0.5, "hi": 0.9},
    ],
)
def test_a_limit_that_limits_nothing_or_says_no_reason_is_refused(values: dict[str, object]) -> None:
    with pytest.raises(UsageError, match="limit '"):
        limit(**values)


def test_shipped_limits_are_valid_and_named_after_scenes() -> None:
    assert find_limits("poles") == "poles"
    assert find_limits("my/scene.toml") is None
    (rate,) = [x for x in load_limits("poles") if x.is_rate]
    assert rate.lo == pytest.approx(0.60)  # the paper's 17 of 21, Wilson
    assert rate.marginal_lo == pytest.approx(0.81)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "no [limits.NAME] table"),
        ("[limits]", "no [limits.NAME] table"),
        ("[limits.x]\nat_least = 1\nreason='r'\nsource='s'", "needs a unit"),
        ("[limits.x]\nunit='m'\natleast = 1\nreason='r'\nsource='s'", "no key 'atleast'"),
        ("[limits.x]\nunit='m'\nat_least = '1'\nreason='r'\nsource='s'", "must be a float"),
        ("[limits.x]\nunit='m'\nat_least = true\nreason='r'\nsource='s'", "must be a float"),
        ("[limits.x]\nunit='m'\nat_least = nan\nreason='r'\nsource='s'", "must be finite"),
        ("[limits.x]\nunit='m'\nreason='r'\nsource='s'", "neither at_least nor at_most"),
        ("[limits.x]\nunit='m'\nat_least = 1\nsource='s'", "needs a reason"),
        ("[limits.y]\nunit='m'\nat_least = 1\nreason='r'\nsource='s'", "unknown metric 'y'"),
        ("[limits", "not valid TOML"),
    ],
)
def test_malformed_limits_name_file_and_fault(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "limits.toml"
    path.write_text(text)
    with pytest.raises(UsageError) as caught:
        load_limits(str(path), known_metrics=("x",))
    assert str(path) in str(caught.value)
    assert says in str(caught.value)
