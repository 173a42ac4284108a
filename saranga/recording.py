"""Recordings of the rig's wire bytes in MCAP: written as they come, readable up to where a crash cut them.

One MCAP message a wire frame, its closing 0x00 included, on channel "rig/wire"; log time is nanoseconds since the
recording began. Frames that do not decode are kept, so a replay has the same counters as the original.
"""

import struct
import zlib
from collections.abc import Generator
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType

import zstandard
from mcap.exceptions import McapError
from mcap.records import Channel, Header, Message, Metadata
from mcap.stream_reader import CRCValidationError, StreamReader
from mcap.writer import CompressionType, Writer

from saranga.errors import DeviceError, UsageError

CHANNEL = "rig/wire"
ENCODING = "saranga-rig-v1"
FLUSH_BYTES = 32_768
FLUSH_US = 1_000_000
"""A crash loses at most this much: what came after the last flush, 32 KiB or 1 s."""
LONGEST_PIECE = 65_536
_RECORD_LIMIT = 1 << 26


class FrameWriter:
    """Writes wire bytes to a new MCAP file.

    Args:
        path: must not exist yet: recordings are never overwritten.
        metadata: texts kept with it (versions, serial numbers, conditions).

    Raises:
        UsageError: the file exists or cannot be created.
    """

    def __init__(self, path: Path, metadata: dict[str, str] | None = None) -> None:
        self.path = path
        self.frames = 0
        try:
            self._file = path.open("xb")
        except FileExistsError:
            raise UsageError(f"{path} exists: recordings are never overwritten; choose another name") from None
        except OSError as error:
            raise UsageError(f"{path} cannot be created: {error.strerror}") from error
        self._writer = Writer(self._file, chunk_size=2 * FLUSH_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(profile="", library="saranga-bench")
        if metadata:
            self._writer.add_metadata("provenance", metadata)
        self._channel = self._writer.register_channel(CHANNEL, ENCODING, 0)
        self._file.flush()
        self._rest = b""
        self._unflushed = 0
        self._flushed_us = 0
        self._last_us = 0

    def write(self, data: bytes, t_us: int) -> None:
        """Append wire bytes, cut anywhere, that arrived `t_us` after the start.

        Raises:
            DeviceError: the disk is full or gone.
        """
        parts = (self._rest + data).split(b"\0")
        self._rest = parts[-1]
        self._last_us = t_us
        try:
            for part in parts[:-1]:
                self._add(part + b"\0", t_us)
            if len(self._rest) > LONGEST_PIECE:
                self._add(self._rest, t_us)
                self._rest = b""
            if self._unflushed >= FLUSH_BYTES or (self._unflushed and t_us - self._flushed_us >= FLUSH_US):
                self._writer.flush()
                self._unflushed, self._flushed_us = 0, t_us
        except OSError as error:
            raise DeviceError(f"{self.path} cannot be written: {error.strerror}; free some space") from error

    def close(self) -> None:
        """Write the unfinished last frame, if any, and the MCAP summary."""
        if self._file.closed:
            return
        try:
            if self._rest:
                self._add(self._rest, self._last_us)
            self._writer.finish()
        except OSError as error:
            raise DeviceError(f"{self.path} cannot be finished: {error.strerror}") from error
        finally:
            self._file.close()

    def __enter__(self) -> "FrameWriter":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self.close()

    def _add(self, frame: bytes, t_us: int) -> None:
        time_ns = t_us * 1000
        self._writer.add_message(self._channel, time_ns, frame, time_ns, self.frames & 0xFFFFFFFF)
        self.frames += 1
        self._unflushed += len(frame)


@dataclass
class Recording:
    """A recording being read. `complete` and `metadata` are right once `frames` has come to its end."""

    path: Path
    complete: bool = False
    metadata: dict[str, str] = field(default_factory=dict)

    def frames(self) -> Generator[tuple[int, bytes], None, None]:
        """(t_us, wire bytes with their 0x00) in the order of recording, up to the end or to where it is cut.

        Raises:
            UsageError: not a file, not an MCAP file, or one without the channel "rig/wire".
        """
        self.complete = False
        channels: dict[int, bool] = {}
        started = False
        try:
            with self.path.open("rb") as file:
                reader = StreamReader(file, validate_crcs=True, record_size_limit=_RECORD_LIMIT)
                for record in reader.records:
                    if isinstance(record, Header):
                        started = True
                    elif isinstance(record, Channel):
                        channels[record.id] = record.topic == CHANNEL
                    elif isinstance(record, Metadata):
                        self.metadata.update(record.metadata)
                    elif isinstance(record, Message) and channels.get(record.channel_id, False):
                        yield record.log_time // 1000, record.data
                self.complete = True
        except OSError as error:
            raise UsageError(f"{self.path} cannot be read: {error.strerror}; give an MCAP recording") from error
        except (McapError, CRCValidationError, zstandard.ZstdError, zlib.error, struct.error, ValueError, KeyError,
                IndexError) as error:
            if not started:
                raise UsageError(f"{self.path} is not an MCAP recording: {error or type(error).__name__}; "
                                 "record one from the rig or import one") from error
        # A file cut before its first chunk has no channel yet: an empty recording, not a foreign one.
        if not any(channels.values()) and (self.complete or channels):
            raise UsageError(f"{self.path} has no channel {CHANNEL!r} (it has {len(channels)} others): "
                             "it is not a recording of the rig")


def read_recording(path: Path) -> Recording:
    """Open a recording for reading.

    Raises:
        UsageError: the file does not exist.
    """
    if not path.is_file():
        raise UsageError(f"recording {str(path)!r} does not exist: give the path of an .mcap file")
    return Recording(path)
