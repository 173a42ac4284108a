"""A rehearsal: `emulated:` in place of a vehicle.

`emulated:`, `emulated:arducopter`, `emulated:?port=pty&fault=no_flow&fault=BATT_LOW_VOLT=0`.
"""

import sys

from bench.emulated import Ordered, split_url
from saranga.errors import UsageError
from sitl.autopilot import KINDS
from sitl.parked_faults import parse_parked_faults

EXAMPLES = "emulated:, emulated:arducopter or emulated:?fault=NAME&port=pty"


def order_vehicle(url: str) -> Ordered:
    """The command of a parked vehicle.

    Raises:
        UsageError: an unknown autopilot, option or fault.
    """
    kind, options = split_url(url, ("fault", "port", "seed"))
    kind = kind or KINDS[0]
    if kind not in KINDS:
        raise UsageError(f"--vehicle {url!r}: autopilot {kind!r} is not known: {', '.join(KINDS)}; use {EXAMPLES}")
    parse_parked_faults([value for key, value in options if key == "fault"])
    command = [sys.executable, "-m", "sitl.parked", "--autopilot", kind]
    for key, value in options:
        command += [f"--{key}", value]
    return Ordered(tuple(command), f"parked vehicle ({kind})")
