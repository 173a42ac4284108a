"""The same campaign through Dask: the same outcomes and hashes, seed by seed, also when a worker dies."""

import contextlib
import json
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest
from campaign_process import CampaignProcess, alive, command_of, table, write_suite

pytest.importorskip("distributed", reason="needs the extra: pip install 'saranga-bench[cluster]'")

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]  # minutes: whole campaigns, several times over


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The table as processes of this machine fly it."""
    folder = tmp_path_factory.mktemp("here")
    campaign = CampaignProcess(write_suite(folder), folder / "runs", "--jobs", "2")
    _, summary = campaign.finish()
    assert summary is not None and summary["metrics"]["trials"] == 8, campaign.lines
    return table(summary)


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[str]:
    """Address of a scheduler on loopback with two workers of one slot each, as an operator would start them."""
    file = tmp_path / "scheduler.json"
    common = ["--scheduler-file", str(file), "--no-dashboard"]
    scheduler = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", *common]
    worker = [sys.executable, "-m", "distributed.cli.dask_worker", "--host", "127.0.0.1", "--nthreads", "1",
              "--resources", "SITL=1", "--local-directory", str(tmp_path / "dask"), *common]
    with contextlib.ExitStack() as stack, (tmp_path / "dask.txt").open("w") as log:
        for command in (scheduler, worker, worker):
            process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)
            stack.callback(_end, process)
            until = time.monotonic() + 300.0
            while not file.exists():
                assert process.poll() is None and time.monotonic() < until, (tmp_path / "dask.txt").read_text()
                time.sleep(0.05)
        yield json.loads(file.read_text())["address"]


def _end(process: subprocess.Popen[bytes]) -> None:
    family = [psutil.Process(process.pid), *psutil.Process(process.pid).children(recursive=True)]
    process.terminate()
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(timeout=10.0)
    for member in family:
        with contextlib.suppress(psutil.Error):
            member.kill()
    process.wait()


def _worker_processes() -> list[psutil.Process]:
    """Those that fly: children of the nannies that `cluster` started."""
    return [child for p in psutil.Process().children() if "dask_worker" in " ".join(command_of(p))
            for child in p.children(recursive=True) if "spawn_main" in " ".join(command_of(child))]


def test_a_cluster_inside_the_process_flies_the_same(here: dict[str, Any], tmp_path: Path) -> None:
    campaign = CampaignProcess(write_suite(tmp_path), tmp_path / "runs", "--dask", "local", "--jobs", "2")
    campaign.wait_for_trials(1)
    _, summary = campaign.finish()
    assert summary is not None, campaign.lines
    campaign.assert_nothing_left()
    assert table(summary) == here
    assert len({t["worker"] for t in summary["outcomes"]}) == 2


def test_a_cluster_elsewhere_flies_the_same_though_a_worker_dies(
        here: dict[str, Any], cluster: str, tmp_path: Path) -> None:
    campaign = CampaignProcess(write_suite(tmp_path), tmp_path / "runs", "--dask", cluster)
    campaign.wait_for_trials(1)
    victim = _worker_processes()[0]
    victim.kill()
    _, summary = campaign.finish()
    assert summary is not None, campaign.lines
    assert not alive(victim)
    assert table(summary) == here
    assert summary["metrics"]["workers"] in (1, 2)
