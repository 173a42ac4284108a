"""The host's decoder against corrupted input: no false frame, no exception, in step again at the next frame."""

import numpy as np
import pytest

from saranga.wire import Config, Decoder, Echo, Fault, Message, Stand, Stop, Throttle, encode

POOL = 400


def messages(rng: np.random.Generator) -> list[Message]:
    """Ones that no memory of sequence numbers can drop: each number is used once."""
    made: list[Message] = []
    for k in range(POOL):
        header = {"sensor": k % 251, "sequence": k * 1_000_003 % 2**31, "trigger": k, "device_time_us": k * 25_600}
        kind = k % 6
        if kind == 0:
            iq = rng.integers(-20_000, 20_000, (int(rng.integers(1, 60)), 2)).astype(np.int16)
            made.append(Echo(fop_hz=53e3, odr=6, mode=0, iq=iq, **header))
        elif kind == 1:
            made.append(Throttle(value=float(np.float32(rng.random())), token=k, deadline_ms=1 + k, **header))
        elif kind == 2:
            made.append(Fault(code=k, text="over current", **header))
        elif kind == 3:
            made.append(Stand(thrust_n=float(rng.normal()), token=k, **header))
        elif kind == 4:
            made.append(Config(odr=2 + k % 5, samples=1 + k, **header))
        else:
            made.append(Stop(**header))
    return made


def corrupted(frame: bytes, rng: np.random.Generator) -> bytes:
    """One to four changes: a bit, a byte, bytes lost, bytes put in, the end cut off, a piece of rubbish."""
    data = bytearray(frame)
    for _ in range(int(rng.integers(1, 5))):
        at = int(rng.integers(len(data) + 1))
        change = int(rng.integers(6))
        if change == 0 and at < len(data):
            data[at] ^= 1 << int(rng.integers(8))
        elif change == 1 and at < len(data):
            data[at] = int(rng.integers(256))
        elif change == 2:
            del data[at:at + int(rng.integers(1, 30))]
        elif change == 3:
            data[at:at] = bytes([int(rng.integers(256))]) * int(rng.integers(1, 20))
        elif change == 4:
            del data[at:]
        else:
            data += rng.bytes(5000 if rng.random() < 0.002 else int(rng.integers(30)))
    return bytes(data)


class EveryFrame(Decoder):
    """Without the memory of sequence numbers, which drops what comes twice: here every frame counts."""

    def _fresh(self, message: Message) -> bool:
        return True


def fuzz(count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    frames = [encode(message) for message in messages(rng)]
    decoder = EveryFrame()
    for k in range(count):
        frame, following = frames[k % POOL], frames[(k * 7 + 3) % POOL]
        # The zero closes what the corruption may have left open.
        for message in decoder.feed(corrupted(frame, rng) + b"\0"):
            assert encode(message) == frame, f"false frame at input {k}: {message}"
        cut = int(rng.integers(len(following)))
        heard = decoder.feed(following[:cut]) + decoder.feed(following[cut:])
        assert [encode(m) for m in heard] == [following], f"not in step again after input {k}"
    counters = decoder.counters
    assert counters.bad_cobs > count // 100 and counters.bad_crc > count // 100


def test_ten_thousand_corrupted_inputs_give_the_host_no_false_frame():
    fuzz(10_000, 1)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_a_million_corrupted_inputs_give_the_host_no_false_frame():
    fuzz(1_000_000, 2)
