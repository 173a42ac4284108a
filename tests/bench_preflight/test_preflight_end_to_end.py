"""Preflight on the real ArduCopter, end to end. Minutes long, so not in the normal suite.

The faults are planted in the running autopilot, its sensors and its link, in simulated time: a busy machine changes
nothing. Clean starts are made both so and in wall time through real ports, with MAVSDK and an emulated rig.
"""

from pathlib import Path

import pytest
from parked_link import QUICK, ParkedLink, ask, judged, with_rest
from planted import VEHICLE, caught

from bench.preflight.collect import Conversation, gather
from bench.preflight.command import Plan, preflight
from bench.preflight.fix import fix_parameters
from bench.preflight.guard import GuardedLink
from bench.preflight.parameter_difference import difference, wanted_parameters
from bench.store import Store
from sitl.autopilot.binary import why_absent

pytestmark = [
    pytest.mark.slow,
    pytest.mark.wall_time,
    pytest.mark.real_arducopter,
    pytest.mark.timeout(400),
    pytest.mark.skipif(why_absent() is not None, reason=str(why_absent())),
]
CLEAN_STARTS = 20


@pytest.mark.parametrize("seed", range(1, CLEAN_STARTS + 1))
def test_a_clean_start_is_a_go(clean, seed):
    evidence, _ = ask(kind="arducopter", seed=seed)
    result = judged(with_rest(evidence, clean))
    assert result["go"], result["reason"]
    print(f"seed {seed}: {result['reason']}")


@pytest.mark.parametrize("planted", VEHICLE, ids=lambda planted: planted.title)
def test_a_fault_of_the_vehicle_is_named(clean, planted):
    evidence, _ = ask(*planted.faults, kind="arducopter")
    result = judged(with_rest(evidence, clean))
    print(f"{planted.title}: {result['reason']}")
    assert caught(result, planted) == ""


@pytest.mark.parametrize("port", ["tcp", "udp", "pty"])
def test_a_clean_start_through_real_ports_is_a_go_within_a_minute(tmp_path: Path, port):
    result = preflight(Plan(f"emulated:arducopter?port={port}", "emulated:"), Store(tmp_path))
    print(f"{port}: {result['metrics']['total_s']} s, {result['metrics']['phases_s']}, {result['reason']}")
    assert result["go"], result["reason"]
    assert result["metrics"]["total_s"] < 60.0
    assert result["metrics"]["mavsdk"]["version"][:2] == [4, 7]


def test_a_log_is_fetched_through_mavsdk(tmp_path: Path):
    result = preflight(Plan("emulated:arducopter", "emulated:", download_log=True), Store(tmp_path))
    assert result["metrics"]["mavsdk"]["log"]["size_bytes"] > 100_000
    assert (Path(result["run"]) / "vehicle.bin").read_bytes()[:2] == b"\xa3\x95"


def test_parameters_are_fixed_on_the_real_firmware():
    link = ParkedLink("MOT_THST_EXPO=0.3", "FS_GCS_ENABLE=0", "BATT_LOW_VOLT=0", kind="arducopter")
    guard = GuardedLink(link)
    conversation = Conversation(guard, now=link.now)
    gather(conversation, [], deadlines=QUICK)
    done = fix_parameters(conversation, guard, wanted_parameters(), lambda prompt: "WRITE")
    link.close()
    assert len(done.written) == 3 and not done.failed
    assert not difference(conversation.evidence, wanted_parameters()).different
