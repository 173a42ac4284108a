"""Errors a person is meant to read: one line naming the thing, the value, the limit and the next action.

Each class carries the exit code that the command line ends with.
"""


class BenchError(Exception):
    """Something the project itself detected; the message is for people, no traceback is needed."""

    exit_code = 4


class UsageError(BenchError):
    """Bad input: an unknown name, a malformed file, an impossible option."""

    exit_code = 2


class DeviceError(BenchError):
    """A device, autopilot or link that is missing, wrong or has failed."""

    exit_code = 4
