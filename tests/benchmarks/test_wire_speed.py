"""Speed of the echo path a frame: wire, assembly, image. Limits hold for the quickest round on a busy 2-core machine.

Budget: a simulated second at 20 times real time has 39 cycles of two sensors, 640 us of it a frame for everything.
"""

import numpy as np
import pytest

from saranga.echo import EchoFrame, EchoImage, sound_speed_m_s
from saranga.wire import CycleAssembler, Decoder, Echo, Hello, SensorInfo, encode

COUNT = 200
RNG = np.random.default_rng(1)
IQ = RNG.integers(-9000, 9000, (256, 2)).astype(np.int16)
ECHOES = [Echo(sensor=0, sequence=n, trigger=n, device_time_us=25_600 * n, fop_hz=53_000.0, odr=6, mode=0, iq=IQ)
          for n in range(COUNT)]


def per_frame_us(benchmark) -> float:
    return benchmark.stats.stats.min / COUNT * 1e6


@pytest.mark.benchmark(group="wire")
def test_encode_and_decode(benchmark):
    def both():
        decoder = Decoder()
        return sum(len(decoder.feed(encode(echo))) for echo in ECHOES)

    assert benchmark(both) == COUNT
    assert per_frame_us(benchmark) < 25


@pytest.mark.benchmark(group="wire")
def test_decode_and_assemble(benchmark):
    stream = b"".join(map(encode, ECHOES))
    hello = Hello(firmware="", sensors=(SensorInfo(sensor=0, role="left", fop_hz=53e3, bandwidth_hz=4e3),))

    def decode():
        decoder, assembler = Decoder(), CycleAssembler()
        assembler.add(hello)
        return sum(assembler.add(m) is not None for m in decoder.feed(stream))

    assert benchmark(decode) == COUNT
    assert per_frame_us(benchmark) < 25


@pytest.mark.benchmark(group="image")
@pytest.mark.parametrize("with_envelope", [False, True])
def test_push(benchmark, with_envelope):
    frames = [EchoFrame("left", 0, n, n, 0, 53_000.0, 6, 0, IQ) for n in range(COUNT)]
    c_m_s = sound_speed_m_s(20.0)

    def push():
        image = EchoImage()
        for frame in frames:
            image.push(frame, c_m_s)
            if with_envelope:
                image.envelope  # noqa: B018
        return image.rows

    assert benchmark(push) == 32
    assert per_frame_us(benchmark) < (25 if with_envelope else 15)
