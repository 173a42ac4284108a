"""Campaigns whose processes die: finished trials count, the rest is flown, nobody is left, the table is the same."""

import signal
import time
from pathlib import Path
from typing import Any

import psutil
import pytest
from campaign_process import CampaignProcess, command_of, table, write_suite

from bench.journal import read_journal

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]  # minutes: whole campaigns, several times over


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The table of the campaign that nobody disturbs."""
    folder = tmp_path_factory.mktemp("undisturbed")
    campaign = CampaignProcess(write_suite(folder), folder / "runs", "--jobs", "2")
    campaign.wait_for_trials(1)
    code, summary = campaign.finish()
    assert summary is not None and code == 3, campaign.lines  # four trials a row decide nothing
    campaign.assert_nothing_left()
    assert summary["metrics"]["trials"] == 8 and summary["metrics"]["determinism_hash"]
    return table(summary)


def test_a_campaign_interrupted_terminated_and_killed_ends_with_the_same_table(
        undisturbed: dict[str, Any], tmp_path: Path) -> None:
    suite, runs = write_suite(tmp_path), tmp_path / "runs"
    again: tuple[str, ...] = ()
    done = 0
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
        campaign = CampaignProcess(suite, runs, "--jobs", "2", *again)
        campaign.wait_for_trials(1)
        campaign.send(number)
        code, summary = campaign.finish()
        campaign.assert_nothing_left()
        journal = read_journal(next(runs.glob("*campaign*")) / "journal.jsonl")
        count = len(journal.of("trial"))
        assert done + 1 <= count < 8
        if number == signal.SIGKILL:
            assert code == -signal.SIGKILL
        else:
            assert code == 130 and summary is not None and summary["interrupted"]
            assert summary["verdict"] == "INCONCLUSIVE" and journal.end is not None
            assert journal.end["state"] == "interrupted" and len(summary["outcomes"]) == count
        again, done = ("--resume", "last"), count
    campaign = CampaignProcess(suite, runs, "--jobs", "2", *again)
    code, summary = campaign.finish()
    assert summary is not None and code == 3, campaign.lines
    assert table(summary) == undisturbed
    journal = read_journal(next(runs.glob("*campaign*")) / "journal.jsonl")
    flown = [(r["row"], r["seed"]) for r in journal.of("trial")]
    assert len(flown) == len(set(flown)) == 8, "a finished trial was flown again"


def test_a_killed_worker_costs_only_the_flight_in_its_hands(undisturbed: dict[str, Any], tmp_path: Path) -> None:
    campaign = CampaignProcess(write_suite(tmp_path), tmp_path / "runs", "--jobs", "2")
    campaign.wait_for_trials(1)
    campaign.workers()[0].kill()
    campaign.wait_for_trials(5)
    code, summary = campaign.finish()
    assert summary is not None and code == 3, campaign.lines
    campaign.assert_nothing_left()
    assert table(summary) == undisturbed
    assert len(summary["warnings"]) <= 1 and all("flown again" in text for text in summary["warnings"])
    assert summary["warnings"], "the worker was idle when it was killed"


@pytest.mark.real_arducopter
def test_a_killed_arducopter_costs_only_its_flight(tmp_path: Path) -> None:
    suite = write_suite(tmp_path, "arducopter")
    tables = []
    for kill in (False, True):
        campaign = CampaignProcess(suite, tmp_path / f"runs-{kill}", "--jobs", "2", "--trials", "2")
        campaign.wait_for_trials(1)
        if kill:
            autopilots: list[psutil.Process] = []
            until = time.monotonic() + 60.0  # between two flights there is none
            while not autopilots and time.monotonic() < until:
                autopilots = [p for p in campaign.family() if "--model" in command_of(p)]
            assert autopilots, "no arducopter flew"
            autopilots[0].kill()
        _, summary = campaign.finish()
        assert summary is not None, campaign.lines
        campaign.assert_nothing_left()
        tables.append(table(summary))
        assert bool(summary["warnings"]) is kill, summary["warnings"]
    assert tables[0] == tables[1]
    assert not [p for p in psutil.Process().children(recursive=True) if "--model" in command_of(p)]
