"""Signed results: HMAC-SHA-256 over the canonical JSON, with a key that is a file.

The standard library has no public-key signatures, so who can verify can sign: the key belongs to those who do both.
"""

import hashlib
import hmac
import json
import os
import secrets
import stat
from pathlib import Path
from typing import Any

from saranga.errors import BenchError, UsageError

METHOD = "HMAC-SHA-256"
LEAST_KEY_BYTES = 32
SIGNATURE = "signature"


def canonical(result: dict[str, Any]) -> bytes:
    """The bytes that are signed: sorted keys, no spaces, ASCII, without the signature itself."""
    bare = {key: value for key, value in result.items() if key != SIGNATURE}
    return json.dumps(bare, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False).encode("ascii")


def make_key(path: Path) -> None:
    """A new key file of 32 random bytes in hexadecimal, readable by its owner only.

    Raises:
        UsageError: the file exists. BenchError: it cannot be written.
    """
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError as error:
        raise UsageError(f"{path} exists: a key is never overwritten; choose another name") from error
    except OSError as error:
        raise BenchError(f"{path}: cannot be written: {error.strerror}") from error
    with os.fdopen(descriptor, "w", encoding="ascii") as file:
        file.write(secrets.token_hex(LEAST_KEY_BYTES) + "\n")


def load_key(path: Path) -> bytes:
    """The key in a file: its text without the white space around it.

    Raises:
        UsageError: missing, too short, or readable by others.
    """
    try:
        data = path.read_bytes().strip()
        mode = path.stat().st_mode
    except OSError as error:
        raise UsageError(f"key file {path}: {error.strerror}; make one with `saranga-bench preflight key {path}`"
                         ) from error
    if len(data) < LEAST_KEY_BYTES:
        raise UsageError(f"key file {path}: {len(data)} bytes, needs {LEAST_KEY_BYTES}; make one with "
                         f"`saranga-bench preflight key FILE`")
    if mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise UsageError(f"key file {path} can be read by others: chmod 600 {path}")
    return data


def key_id(key: bytes) -> str:
    """Eight hexadecimal digits that tell keys apart and give nothing away."""
    return hashlib.sha256(b"saranga-bench preflight key id\0" + key).hexdigest()[:8]


def signed(result: dict[str, Any], key: bytes) -> dict[str, Any]:
    """The result with its signature."""
    value = hmac.new(key, canonical(result), hashlib.sha256).hexdigest()
    return {**result, SIGNATURE: {"method": METHOD, "key_id": key_id(key), "value": value}}


def problem(result: dict[str, Any], key: bytes) -> str:
    """Why the signature does not hold; "" where it does."""
    signature = result.get(SIGNATURE)
    if not isinstance(signature, dict) or "value" not in signature:
        return "it is not signed"
    if signature.get("method") != METHOD:
        return f"it is signed by {signature.get('method')!r}, this version knows {METHOD}"
    if signature.get("key_id") != key_id(key):
        return f"it was signed with another key ({signature.get('key_id')}, this one is {key_id(key)})"
    value = hmac.new(key, canonical(result), hashlib.sha256).hexdigest()
    return "" if hmac.compare_digest(value, str(signature["value"])) else "it was changed after it was signed"


def load_result(path: Path) -> dict[str, Any]:
    """A preflight's JSON file.

    Raises:
        UsageError: missing, or not one.
    """
    try:
        result = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror}; give the preflight.json of a run folder") from error
    except (ValueError, UnicodeDecodeError) as error:
        raise UsageError(f"{path}: is not JSON ({error}); give the preflight.json of a run folder") from error
    if not isinstance(result, dict) or "checks" not in result:
        raise UsageError(f"{path}: is no preflight result; give the preflight.json of a run folder")
    return result
