"""The rig's share of a device that the supervisor holds: the same bytes on a loopback port, without the throttle."""

from typing import Protocol

from saranga.byte_links import ByteLink
from saranga.framing import Decoder, encode
from saranga.messages import Config, HelloRequest, SelfTest, Start, Stop
from sitl.rig_ports import TcpPort

ALLOWED = (HelloRequest, Config, Start, Stop, SelfTest)


class Sink(Protocol):
    """Takes bytes."""

    def write(self, data: bytes) -> None: ...


class Tee:
    """Every byte of the device goes to the port; of the frames from there only what a rig needs goes on.

    THROTTLE is refused and counted, and so is all else that is not on the list.
    """

    def __init__(self) -> None:
        self._port = TcpPort()
        self._decoder = Decoder()
        self.refused = 0
        self._was_listening = False

    @property
    def url(self) -> str:
        """tcp://127.0.0.1:PORT for the rig driver."""
        return self._port.url

    @property
    def dropped_bytes(self) -> int:
        """Bytes of the device that the rig's user did not fetch in time."""
        return self._port.dropped_bytes

    def from_device(self, data: bytes) -> None:
        """Pass on what the device sent, if anybody listens."""
        if self._port.listening:
            self._port.write(data)

    def pump(self, device: Sink) -> None:
        """Pass on to the device what the rig's user sent and may send. Raises DeviceError when the device is gone."""
        listening = self._port.listening
        if listening and not self._was_listening:
            self._decoder = Decoder()  # another user: no half frame of the one before
        self._was_listening = listening
        for message in self._decoder.feed(self._port.read()):
            if isinstance(message, ALLOWED):
                device.write(encode(message))
            else:
                self.refused += 1

    def close(self) -> None:
        """May be called twice."""
        self._port.close()


class TeedLink:
    """A byte link whose every read byte also goes to the tee."""

    def __init__(self, link: ByteLink, tee: Tee) -> None:
        self.url = link.url
        self._link = link
        self._tee = tee

    def open(self) -> None:
        """As the link."""
        self._link.open()

    def read(self, timeout_s: float) -> bytes:
        """As the link."""
        data = self._link.read(timeout_s)
        if data:
            self._tee.from_device(data)
        return data

    def write(self, data: bytes) -> None:
        """As the link."""
        self._link.write(data)

    def close(self) -> None:
        """As the link."""
        self._link.close()
