"""Records `clean_arducopter.json` anew: python tests/bench_preflight/record_clean.py (needs the ArduCopter binary)."""

import dataclasses
import json
from pathlib import Path
from typing import Any

from parked_link import ask

OUT = Path(__file__).parent / "clean_arducopter.json"


def rounded(value: Any) -> Any:
    """Seven figures are enough."""
    if isinstance(value, float):
        return float(f"{value:.7g}")
    if isinstance(value, dict):
        return {key: rounded(item) for key, item in value.items()}
    return [rounded(item) for item in value] if isinstance(value, list | tuple) else value


if __name__ == "__main__":
    evidence, _ = ask(kind="arducopter")
    vehicle = evidence.vehicle
    assert vehicle is not None and not vehicle.stopped
    vehicle.url = f"recorded: ArduCopter SITL {vehicle.firmware_hash}, parked, simulated time"
    OUT.write_text(json.dumps(rounded(dataclasses.asdict(vehicle)), separators=(",", ":")) + "\n", encoding="utf-8")
    print(f"{OUT}: {OUT.stat().st_size} bytes")
