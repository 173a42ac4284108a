"""Faults of the emulated rig and of the network's files, seen by the whole preflight; simulated time."""

import json
import shutil
from dataclasses import replace

import pytest
from parked_link import ask_rig, judged
from planted import RIG, caught

from bench.preflight.stack_timing import time_stack
from saranga.errors import BenchError
from saranga.fixtures import fixture_path


@pytest.mark.parametrize("planted", RIG, ids=lambda planted: planted.title)
def test_a_fault_of_the_rig_is_named(clean, planted):
    try:
        clean.rig = replace(ask_rig(*planted.faults, seconds=8.0), heard_s=clean.now_s - 2.0)
    except BenchError as error:
        clean.rig, clean.absent["rig"] = None, str(error)
    result = judged(clean, rig="emulated:")
    print(f"{planted.title}: {result['reason']}")
    assert caught(result, planted) == ""


def test_no_reflector_leaves_it_open(clean):
    clean.rig.evidence = replace(clean.rig.evidence, reflector="none", reflector_range_m=None)
    result = judged(clean, rig="emulated:")
    rows = {row["name"]: row for row in result["checks"]}
    assert not result["go"] and rows["reflector_given"]["verdict"] == "INCONCLUSIVE"


def test_a_damaged_weights_file_is_found(clean, tmp_path):
    source = fixture_path("models", "saranga", ".json")
    listed = json.loads(source.read_text())["files"].values()
    for file in [source, *(source.parent / entry["file"] for entry in listed)]:
        shutil.copy(file, tmp_path)
    weights = tmp_path / "saranga-int8.onnx"
    data = bytearray(weights.read_bytes())
    data[1000] ^= 1
    weights.write_bytes(bytes(data))
    model = str(tmp_path / "saranga.json")
    clean.stack = time_stack("saranga", "saranga", "pair", 0.5, tmp_path, steps=50, model=model)
    clean.stack.heard_s = clean.now_s
    result = judged(clean)
    rows = {row["name"]: row for row in result["checks"]}
    assert rows["weights_wrong"]["verdict"] == "FAIL" and "int8 differ" in rows["weights_wrong"]["why"]
