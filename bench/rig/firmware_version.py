"""Which firmware this version of the bench works with, and where its numbers come from."""

import re

from saranga.errors import DeviceError
from saranga.wire import Hello

SUPPORTED = {"saranga-rig": 1, "virtual rig": 1}
"""Name -> major version; a new minor version only adds."""
_TEXT = re.compile(r"^(?P<name>.+?) v?(?P<major>\d+)(\.\d+)*( .*)?$")


def check_firmware(url: str, hello: Hello) -> None:
    """Raise DeviceError unless the rig's firmware is one that this version knows."""
    found = _TEXT.match(hello.firmware)
    known = ", ".join(f"{name} {major}.x" for name, major in SUPPORTED.items())
    if found is None or found["name"] not in SUPPORTED:
        raise DeviceError(f"{url}: firmware {hello.firmware!r} is not one this version knows ({known}): flash the rig "
                          "with bench/firmware (docs/firmware.md)")
    if int(found["major"]) != SUPPORTED[found["name"]]:
        raise DeviceError(f"{url}: firmware {hello.firmware!r} has another major version than this bench works with "
                          f"({known}): flash the rig with bench/firmware, or use the bench version it was made for")


def origin_of(hello: Hello) -> str:
    """"emulated" for emulated and virtual rigs, else "measured"."""
    text = hello.firmware.lower()
    return "emulated" if "emulated" in text or "virtual" in text else "measured"
