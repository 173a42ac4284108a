"""Recordings: every byte comes back, and a file cut anywhere gives all that was flushed before the cut."""

import random
from pathlib import Path

import numpy as np
import pytest
from golden_frames import FRAMES

from saranga.errors import UsageError
from saranga.recording import FLUSH_BYTES, FrameWriter, read_recording
from saranga.wire import Decoder, Echo, encode


def frames_of(count: int, seed: int = 0) -> list[bytes]:
    rng = np.random.default_rng(seed)
    return [encode(Echo(sensor=0, sequence=n, trigger=n, device_time_us=25_600 * n, fop_hz=53_000.0, odr=6, mode=0,
                        iq=rng.integers(-9000, 9000, (256, 2)).astype(np.int16))) for n in range(count)]


def write(path: Path, frames: list[bytes]) -> None:
    with FrameWriter(path, {"rig": "test", "serial": "A1"}) as writer:
        for n, frame in enumerate(frames):
            writer.write(frame, 25_600 * n)


def test_bytes_times_and_metadata_come_back(tmp_path):
    frames = frames_of(100)
    write(tmp_path / "a.mcap", frames)
    recording = read_recording(tmp_path / "a.mcap")
    assert list(recording.frames()) == [(25_600 * n, f) for n, f in enumerate(frames)]
    assert recording.complete and recording.metadata == {"rig": "test", "serial": "A1"}


def test_chunks_cut_anywhere_and_rubbish_are_kept(tmp_path):
    """A replay counts the same faults as the live link did."""
    stream = b"\x07rubbish\0" + b"".join(FRAMES.values()) + FRAMES["stop"][:-3]
    cut = random.Random(3)
    with FrameWriter(tmp_path / "a.mcap") as writer:
        at = 0
        while at < len(stream):
            step = cut.randint(1, 40)
            writer.write(stream[at:at + step], at)
            at += step
    frames = [f for _, f in read_recording(tmp_path / "a.mcap").frames()]
    assert b"".join(frames) == stream and len(frames) == len(FRAMES) + 2
    live, replay = Decoder(), Decoder()
    live.feed(stream)
    for frame in frames:
        replay.feed(frame)
    assert live.counters == replay.counters and live.counters.bad_cobs + live.counters.bad_crc == 1


def test_other_tools_can_read_it(tmp_path):
    """With MCAP's own indexed reader: a well-formed file with one channel, zstd chunks and the right count."""
    from mcap.reader import make_reader

    write(tmp_path / "a.mcap", frames_of(80))
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert [c.topic for c in summary.channels.values()] == ["rig/wire"]
        assert summary.statistics.message_count == 80
        assert {c.compression for c in summary.chunk_indexes} == {"zstd"}
        assert sum(1 for _ in reader.iter_messages(topics=["rig/wire"])) == 80


def test_file_cut_in_half_gives_half(tmp_path):
    frames = frames_of(400)
    path = tmp_path / "a.mcap"
    write(path, frames)
    data = path.read_bytes()
    path.write_bytes(data[:len(data) // 2])
    recording = read_recording(path)
    got = [f for _, f in recording.frames()]
    assert got == frames[:len(got)] and not recording.complete
    assert len(got) > 200 - 2 * FLUSH_BYTES / len(frames[0])


def test_file_cut_anywhere_never_raises_after_its_head(tmp_path):
    """Each cut yields a prefix of the frames, longer with a longer file."""
    frames = frames_of(120)
    path = tmp_path / "a.mcap"
    write(path, frames)
    data = path.read_bytes()
    lengths = []
    for size in [*range(120, len(data), 1499), len(data) - 1]:
        path.write_bytes(data[:size])
        recording = read_recording(path)
        got = [f for _, f in recording.frames()]
        assert got == frames[:len(got)] and not recording.complete
        lengths.append(len(got))
    assert lengths == sorted(lengths) and lengths[-1] == 120


def test_crash_without_close_loses_at_most_the_last_flush(tmp_path):
    """The file as another process sees it while the writer still runs (or was killed)."""
    frames = frames_of(200)
    writer = FrameWriter(tmp_path / "a.mcap")
    for n, frame in enumerate(frames):
        writer.write(frame, 25_600 * n)
    on_disk = [f for _, f in read_recording(tmp_path / "a.mcap").frames()]
    assert on_disk == frames[:len(on_disk)] and len(on_disk) >= 200 - FLUSH_BYTES // len(frames[0]) - 1
    writer.close()


def test_slow_stream_is_flushed_by_time(tmp_path):
    writer = FrameWriter(tmp_path / "a.mcap")
    writer.write(FRAMES["status"], 0)
    writer.write(FRAMES["status"], 1_000_000)
    assert len(list(read_recording(tmp_path / "a.mcap").frames())) == 2
    writer.close()


def test_damage_in_the_middle_ends_the_recording_there(tmp_path):
    """A flipped byte in a chunk fails the chunk's CRC: nothing after it is believed."""
    frames = frames_of(200)
    path = tmp_path / "a.mcap"
    write(path, frames)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)
    recording = read_recording(path)
    got = [f for _, f in recording.frames()]
    assert 0 < len(got) < 200 and got == frames[:len(got)] and not recording.complete


def test_never_overwrites(tmp_path):
    write(tmp_path / "a.mcap", frames_of(3))
    with pytest.raises(UsageError, match="never overwritten"):
        FrameWriter(tmp_path / "a.mcap")
    assert len(list(read_recording(tmp_path / "a.mcap").frames())) == 3


def test_unusable_files_are_named(tmp_path):
    with pytest.raises(UsageError, match=r"nothere\.mcap.*does not exist"):
        read_recording(tmp_path / "nothere.mcap")
    with pytest.raises(UsageError, match=r"cannot be created"):
        FrameWriter(tmp_path / "no" / "folder.mcap")
    for content in (b"", b"hello, this is not MCAP at all"):
        (tmp_path / "b.mcap").write_bytes(content)
        with pytest.raises(UsageError, match=r"b\.mcap is not an MCAP recording"):
            list(read_recording(tmp_path / "b.mcap").frames())


def test_foreign_mcap_is_named(tmp_path):
    from mcap.writer import Writer

    with (tmp_path / "c.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.register_channel("/camera", "x", 0)
        writer.finish()
    with pytest.raises(UsageError, match="no channel 'rig/wire'"):
        list(read_recording(tmp_path / "c.mcap").frames())
