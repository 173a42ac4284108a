"""Evidence that several tests share: gathered once, copied by who changes it."""

import copy
import json
from pathlib import Path

import pytest
from parked_link import ask, ask_rig

from bench.preflight.evidence import Evidence, Heard, StackSide, VehicleEvidence
from bench.preflight.parameter_difference import wanted_parameters
from bench.preflight.rig_side import RigSide

RECORDED = Path(__file__).parent / "clean_arducopter.json"


def load_vehicle(path: Path) -> VehicleEvidence:
    """`vehicle.json` of a run folder as evidence again."""
    data = json.loads(path.read_text(encoding="utf-8"))
    data["messages"] = {name: [Heard(t_s, fields) for t_s, fields in heard] for name, heard in data["messages"].items()}
    data["watch_s"] = tuple(data["watch_s"])
    data["texts"] = [tuple(text) for text in data["texts"]]
    data["other_vehicles"] = tuple(data["other_vehicles"])
    data["intervals_us"] = {int(key): value for key, value in data["intervals_us"].items()}
    return VehicleEvidence(**data)


@pytest.fixture(scope="session")
def rig_side() -> RigSide:
    return ask_rig()


@pytest.fixture(scope="session")
def _recorded() -> VehicleEvidence:
    return load_vehicle(RECORDED)


@pytest.fixture
def clean(_recorded, rig_side) -> Evidence:
    """Everything in order: a recorded ArduCopter, a simulated rig, a fast stack; made anew for each test."""
    vehicle = copy.deepcopy(_recorded)
    now_s = vehicle.watch_s[1] + 20.0
    rig = RigSide(rig_side.url, rig_side.evidence, rig_side.origin, now_s - 5.0)
    sums = {"int8": "a" * 64, "fp32": "b" * 64}
    stack = StackSide("saranga", "saranga", [3.0] * 120, 62.5, sums, dict(sums), "int8", "some CPU", 50 * 10**9, 2026,
                      now_s)
    seen = {"version": [4, 7, 0], "health": {"gyroscope calibrated": True}, "voltage_v": 16.6, "heard_s": now_s - 8.0}
    return Evidence(vehicle, rig, stack, seen, wanted=wanted_parameters(), now_s=now_s)


@pytest.fixture(scope="session")
def embedded() -> Evidence:
    """A clean embedded vehicle, asked in simulated time. Not to be changed."""
    return ask()[0]
