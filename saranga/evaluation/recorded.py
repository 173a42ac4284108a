"""Frames of one sensor from a recording, or from a log that can be imported, and how much of it was lost."""

import json
import struct
import tempfile
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.stream_reader import CRCValidationError

from saranga.echo import ROLES, EchoFrame
from saranga.errors import UsageError
from saranga.recording import read_recording
from saranga.wire import MODE_TRANSMIT_RECEIVE, CycleAssembler, Decoder

MCAP_MAGIC = b"\x89MCAP0\r\n"


@dataclass(frozen=True, eq=False)
class RecordedFrames:
    """Transmit/receive frames of one sensor in the order of their triggers.

    Attributes:
        left_out: triggers that are in the file but are no measurement in flight: equal to the frame before it, or
            from before take-off, as the metadata of an imported log says.
        lost: what is missing or broken, in numbers; `complete` False where the file ends too early or is broken within.
        amplitude_only: there is no phase: I is the amplitude and Q is 0.
    """

    path: Path
    role: str
    frames: list[EchoFrame]
    left_out: frozenset[int]
    repeated: int
    before_take_off: int
    lost: dict[str, int]
    complete: bool
    amplitude_only: bool
    metadata: dict[str, str] = field(default_factory=dict)

    @property
    def samples(self) -> int:
        """Of the longest frame."""
        return max(len(frame.iq) for frame in self.frames)

    @property
    def losses(self) -> str:
        """In words; "nothing lost" where that is so."""
        said = [f"{count} {name.replace('_', ' ')}" for name, count in self.lost.items() if count]
        if not self.complete and not self.lost["frames_after_the_break"]:
            said.append("the file is cut off: what came after the last frame is lost, how much it does not say")
        return ", ".join(said) or "nothing lost"


def read_recorded(path: Path, role: str | None = None) -> RecordedFrames:
    """Everything readable of one sensor.

    Args:
        path: an .mcap recording of the rig, or a log in one of the formats of `saranga.importers`.
        role: which sensor; None takes the first of left, right, down that is there.

    Raises:
        UsageError: no such file, neither a recording nor a log of a known format, no such sensor, or no
            transmit/receive frame of it.
    """
    if not _is_mcap(path):
        return _read_log(path, role)
    recording = read_recording(path)
    decoder, assembler = Decoder(), CycleAssembler()
    messages = [message for _, data in recording.frames() for message in decoder.feed(data)]
    cycles = [cycle for cycle in (*(assembler.add(message) for message in messages), assembler.flush()) if cycle]
    heard = [r for r in ROLES if any(r in cycle.frames for cycle in cycles)]
    if not heard:
        raise UsageError(f"{path}: no frame of a known sensor can be read ({len(messages)} messages, "
                         f"{'with' if assembler.hello else 'without'} HELLO): it is empty or cut off at its start")
    if role is not None and role not in heard:
        raise UsageError(f"{path}: no frame of a sensor {role!r} in it: it has {', '.join(heard)}; choose with --role")
    role = role or heard[0]
    every = [cycle.frames[role] for cycle in cycles if role in cycle.frames]
    frames = [frame for frame in every if frame.mode == MODE_TRANSMIT_RECEIVE]
    if not frames:
        raise UsageError(f"{path}: all {len(every)} frames of sensor {role!r} are receive-only, there is no echo in "
                         "them: record in transmit/receive mode")
    metadata = recording.metadata
    sensor = frames[0].sensor
    repeated = {step for number, step in _listed(path, metadata, "repeated_frames") if number == sensor}
    early = set(_listed(path, metadata, "before_take_off_steps"))
    triggers = {frame.trigger for frame in frames}
    if not triggers - repeated - early:
        raise UsageError(f"{path}: all {len(frames)} frames of sensor {role!r} are repeated or from before take-off: "
                         "there is nothing to evaluate")
    counters = decoder.counters
    expected = None if recording.complete else _messages_said(path)
    read = counters.messages + counters.bad_cobs + counters.bad_crc + counters.bad_message
    lost = {"frames_missing": counters.gaps_by_sensor.get(sensor, 0),
            "frames_broken": counters.bad_cobs + counters.bad_crc + counters.bad_message,
            "frames_after_the_break": max(0, expected - read) if expected is not None else 0,
            "receive_only": len(every) - len(frames)}
    return RecordedFrames(path, role, frames, frozenset((repeated | early) & triggers), len(repeated & triggers),
                          len(early & triggers), lost, recording.complete, metadata.get("content") == "amplitude",
                          dict(metadata))


def _is_mcap(path: Path) -> bool:
    if path.is_dir() or not path.exists():
        raise UsageError(f"recording {str(path)!r} {'is a folder' if path.is_dir() else 'does not exist'}: give the "
                         "path of an .mcap file or of a log that can be imported")
    try:
        with path.open("rb") as file:
            return file.read(len(MCAP_MAGIC)) == MCAP_MAGIC
    except OSError as error:
        raise UsageError(f"{path} cannot be read: {error.strerror}") from error


def _read_log(path: Path, role: str | None) -> RecordedFrames:
    """What `saranga-bench rig import` would make of it."""
    from saranga.import_log import import_log

    with tempfile.TemporaryDirectory(prefix="saranga-import-") as folder:
        imported = Path(folder) / "log.mcap"
        import_log(path, imported)
        return replace(read_recorded(imported, role), path=path)


def _listed(path: Path, metadata: dict[str, str], key: str) -> list[Any]:
    try:
        found = json.loads(metadata.get(key, "[]"))
        ok = isinstance(found, list) and all(
            isinstance(e, int) or (isinstance(e, list) and len(e) == 2) for e in found)
    except json.JSONDecodeError:
        ok, found = False, []
    if not ok:
        raise UsageError(f"{path}: its metadata {key!r} is {metadata[key]!r}: expected a JSON list as rig import "
                         "writes it")
    return found


def _messages_said(path: Path) -> int | None:
    """How many messages the file says it has, at its end; None where the end is missing."""
    try:
        with path.open("rb") as file:
            summary = make_reader(file).get_summary()
    except (McapError, CRCValidationError, OSError, ValueError, KeyError, IndexError, EOFError, struct.error):
        return None
    return summary.statistics.message_count if summary is not None and summary.statistics is not None else None
