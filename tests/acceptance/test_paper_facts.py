"""Every number of the paper that the simulator must reproduce: `python -m sitl.paper_facts` prints them."""

from dataclasses import replace

import numpy as np
import pytest

from sitl.paper_facts import FACTS, Fact, psnr_db, table

AGREE = [fact for fact in FACTS if not fact.contradicted]
DISAGREE = [fact for fact in FACTS if fact.contradicted]


@pytest.mark.parametrize("fact", AGREE, ids=lambda fact: fact.name)
def test_simulator_agrees_with_the_paper(fact: Fact) -> None:
    value = fact.measure()
    assert fact.verdict(value) == "PASS", f"{value:g} against {fact.paper:g} +- {fact.tolerance:g}: {fact.reason}"


@pytest.mark.parametrize("fact", DISAGREE, ids=lambda fact: fact.name)
def test_where_physics_contradicts_the_paper_the_simulator_sides_with_physics(fact: Fact) -> None:
    assert fact.verdict(fact.measure()) == "DISAGREES", fact.reason


def test_exactly_one_row_is_expected_to_disagree_and_every_row_gives_its_reason() -> None:
    assert [fact.name for fact in DISAGREE] == ["PVC pipe over a large flat face, intensity at 1 m"]
    assert all(fact.reason for fact in FACTS)
    assert len({fact.name for fact in FACTS}) == len(FACTS) >= 25


def test_a_wrong_value_fails_its_row() -> None:
    for fact in FACTS:
        off = fact.paper + fact.tolerance * 1.01 + 1e-9
        assert fact.verdict(off) == ("DISAGREES" if fact.contradicted else "FAIL")
        assert fact.verdict(float("nan")) == "FAIL"
    assert replace(DISAGREE[0], measure=lambda: 0.5).verdict(0.5) == "FAIL"


def test_the_anchor_moves_with_the_pole_and_the_shield() -> None:
    # The end-to-end figure is no constant: a thinner pole and a farther one are weaker by their laws, a shield wins.
    assert psnr_db(1.0, 0.025) == pytest.approx(-4.9 - 3.7, abs=0.5)
    assert psnr_db(1.4, 0.060) == pytest.approx(-4.9 - 30 * np.log10(1.4) - 0.4 * 3.5, abs=0.6)
    assert psnr_db(1.0, 0.060, "foam") - psnr_db(1.0, 0.060) == pytest.approx(12.0, abs=2.0)


def test_the_table_shows_every_row_with_its_verdict() -> None:
    rows = table().splitlines()
    assert len(rows) == 2 + len(FACTS)
    assert sum("| PASS |" in row for row in rows) == len(AGREE) and sum("| DISAGREES |" in row for row in rows) == 1
