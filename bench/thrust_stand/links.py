"""The byte link behind a stand's URL: serial port or TCP."""

from bench.thrust_stand.registry import Where
from saranga.byte_links import ByteLink, SerialLink, TcpLink

DEFAULT_BAUD = 115_200


def byte_link(where: Where, baud: int, forms: str) -> ByteLink:
    """A link that is not open yet.

    Raises:
        ValueError: a baud rate that is none.
        UsageError: neither serial nor TCP, or no port in it.
    """
    if not isinstance(baud, int) or not 10 <= baud <= 99_999_999:
        raise ValueError(f"baud is {baud!r}: it must be 10..99999999")
    if where.transport == "serial" and where.path.startswith("/"):
        return SerialLink(where.url, where.path, baud)
    if where.transport == "tcp" and where.host and where.port:
        return TcpLink(where.url, where.host, where.port)
    raise where.refused(forms)
