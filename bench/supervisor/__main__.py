"""`python -m bench.supervisor FD`: the process that `Supervisor.start` starts; not for people."""

import os
import signal
import socket
import sys
import time
from typing import Any

START_TIMEOUT_S = 10.0


def main() -> int:
    """Take the plan from the channel and serve it."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda number, frame: sys.exit(128 + number))  # nothing is open yet
    from bench.supervisor.channel import Channel
    from bench.supervisor.plan import Confirmation, SupervisorPlan
    from bench.supervisor.worker import serve

    channel = Channel(socket.socket(fileno=int(sys.argv[1])))
    asked = _first(channel)
    if asked is None:
        return 4
    code = serve(channel, SupervisorPlan.from_dict(asked["plan"]), Confirmation(**asked["confirmation"]))
    channel.close()
    os._exit(code)  # All is closed and on disk; taking libraries down would take a second for nothing.


def _first(channel: Any) -> dict[str, Any] | None:
    end_s = time.monotonic() + START_TIMEOUT_S
    while time.monotonic() < end_s and not channel.ended:
        messages = channel.receive()
        if messages:
            return dict(messages[0])
        time.sleep(0.005)
    return None


if __name__ == "__main__":
    sys.exit(main())
