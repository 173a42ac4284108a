"""MAVLink 2 signing of the physical link: a shared key, so that nobody else on the wire can speak for the vehicle.

With a key, all that is sent is signed, and what comes in unsigned, wrongly signed or for the second time is not heard.
Signing keeps others from speaking, not from listening: the bytes are not encrypted.

Source: MAVLink guide, "Message Signing" (48-bit timestamp in units of 10 us since 2015-01-01; SHA-256 over key, packet,
link id and timestamp, its first 48 bits sent).
"""

import hashlib
import hmac
import re
import stat
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from saranga.errors import UsageError

KEY_BYTES = 32
EPOCH_S = 1_420_070_400
TICKS_A_SECOND = 100_000
NEW_STREAM_TICKS = 60 * TICKS_A_SECOND
"""A sender heard for the first time may be this far behind our clock."""
SIGNATURE_BYTES = 6


def load_sign_key(path: Path) -> bytes:
    """The 32 bytes of a key file: 64 hexadecimal digits, or 32 raw bytes.

    Raises:
        UsageError: no such file, another content, or a file that others may read.
    """
    try:
        mode = path.stat().st_mode
        data = path.read_bytes()
    except OSError as error:
        raise UsageError(f"sign key {path}: cannot be read: {error.strerror}; make one with "
                         f"`(umask 077; openssl rand -hex 32 > {path})`") from error
    if mode & (stat.S_IRGRP | stat.S_IROTH):
        raise UsageError(f"sign key {path}: mode {stat.S_IMODE(mode):03o} lets others read it: chmod 600 {path}")
    text = data.strip()
    if re.fullmatch(rb"[0-9a-fA-F]{64}", text):
        return bytes.fromhex(text.decode())
    if len(data) == KEY_BYTES:
        return data
    raise UsageError(f"sign key {path}: {len(data)} bytes: a key is 64 hexadecimal digits or {KEY_BYTES} raw bytes")


class SigningMavlink(mavlink.MAVLink):
    """A MAVLink end that signs what it packs and hears only what is rightly signed with the same key.

    pymavlink's own check believes a packet's timestamp before it has looked at the signature, so that one forged packet
    silences a sender for good; this one looks first.

    Args:
        key: 32 bytes.
        now_s: the clock, seconds since 1970.
    """

    def __init__(self, system_id: int, component_id: int, key: bytes, now_s: Callable[[], float] = time.time) -> None:
        super().__init__(None, srcSystem=system_id, srcComponent=component_id)
        if len(key) != KEY_BYTES:
            raise UsageError(f"sign key of {len(key)} bytes: it must have {KEY_BYTES}")
        self._now_s = now_s
        self.signing.secret_key = key
        self.signing.sign_outgoing = True
        self.advance_clock()

    def advance_clock(self) -> None:
        """Never behind the wall clock, never behind what was sent or heard: call before packing."""
        now = round((self._now_s() - EPOCH_S) * TICKS_A_SECOND)
        self.signing.timestamp = max(self.signing.timestamp, now)

    def check_signature(self, msgbuf: bytearray, srcSystem: int, srcComponent: int) -> bool:
        """Whether a signed packet is authentic and new; called by pymavlink's decoder."""
        signed, signature = bytes(msgbuf[:-SIGNATURE_BYTES]), bytes(msgbuf[-SIGNATURE_BYTES:])
        expected = hashlib.sha256(self.signing.secret_key + signed).digest()[:SIGNATURE_BYTES]
        if not hmac.compare_digest(expected, signature):
            return False
        timestamp = int.from_bytes(signed[-SIGNATURE_BYTES:], "little")
        stream = (signed[-SIGNATURE_BYTES - 1], srcSystem, srcComponent)
        last = self.signing.stream_timestamps.get(stream)
        self.advance_clock()
        too_old = timestamp <= last if last is not None else timestamp + NEW_STREAM_TICKS < self.signing.timestamp
        if too_old:
            return False
        self.signing.stream_timestamps[stream] = timestamp
        self.signing.timestamp = max(self.signing.timestamp, timestamp)
        return True

    def decode(self, msgbuf: bytearray) -> Any:
        """As pymavlink's, which passes messages of unknown type on before it looks at their signature; here none is.

        Raises:
            mavlink.MAVError: unsigned, wrongly signed, seen before or malformed.
        """
        message = super().decode(msgbuf)
        if isinstance(message, mavlink.MAVLink_unknown):
            raise mavlink.MAVError(f"message {message.get_msgId()} is not known, nor its signature checked")
        return message
