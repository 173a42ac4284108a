"""KISS ESC telemetry: golden bytes, wrong bytes, and streams cut anywhere."""

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.thrust_stand.kiss import EscTelemetry, KissDecoder, crc8, decode, encode

# 37 C, 16.48 V, 12.34 A, 250 mAh, 84 000 erpm; the CRC worked out by long division by 0x107
GOLDEN = bytes.fromhex("25" "0670" "04d2" "00fa" "0348" "ec")
MEANING = EscTelemetry(37.0, 16.48, 12.34, 250, 84_000)


def test_crc8_has_the_check_value_of_its_polynomial() -> None:
    assert crc8(b"123456789") == 0xF4, "CRC-8 (poly 0x07, init 0): the catalogue's check value"
    assert crc8(b"") == 0


def test_the_golden_frame_means_what_it_says() -> None:
    got = decode(GOLDEN)
    assert got is not None
    assert (got.temperature_c, got.charge_mah, got.erpm) == (37.0, 250, 84_000)
    assert (got.voltage_v, got.current_a) == pytest.approx((16.48, 12.34))
    assert got.rpm(14) == pytest.approx(12_000.0)
    assert encode(MEANING) == GOLDEN


def test_a_frosty_esc_reads_below_zero() -> None:
    frame = encode(EscTelemetry(-5.0, 16.0, 0.0, 0, 0))
    got = decode(frame)
    assert frame[0] == 0xFB and got is not None and got.temperature_c == -5.0


@pytest.mark.parametrize("bit", range(80))
def test_every_single_bit_error_is_rejected(bit: int) -> None:
    wrong = bytearray(GOLDEN)
    wrong[bit // 8] ^= 1 << bit % 8
    assert decode(bytes(wrong)) is None


def test_a_frame_of_another_length_is_none() -> None:
    assert decode(GOLDEN[:9]) is None and decode(GOLDEN + b"\0") is None and decode(b"") is None


@pytest.mark.parametrize("piece", [1, 3, 10, 64])
def test_a_stream_cut_anywhere_gives_every_frame(piece: int) -> None:
    frames = [encode(EscTelemetry(20.0 + k, 16.0, 0.01 * k, k, 100 * k)) for k in range(50)]
    data, decoder = b"".join(frames), KissDecoder()
    got = [t for k in range(0, len(data), piece) for t in decoder.feed(data[k:k + piece])]
    assert [t.charge_mah for t in got] == list(range(50)) and decoder.lost_bytes == 0


def test_a_reader_that_joins_in_the_middle_or_loses_bytes_finds_its_place_again() -> None:
    rng = random.Random(5)
    frames = [encode(EscTelemetry(20.0, 15.0, 0.5 + 0.01 * k, 1000 + k, 100 * k)) for k in range(100)]
    data = bytearray(b"".join(frames)[4:])
    del data[503:506]
    data[800] ^= rng.randrange(1, 256)
    decoder = KissDecoder()
    got = decoder.feed(bytes(data))
    numbers = [t.charge_mah - 1000 for t in got]
    assert numbers == sorted(numbers) and len(set(numbers)) == len(numbers)
    assert len(numbers) >= 94 and numbers[-1] == 99
    assert decoder.lost_bytes > 0


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=300))
def test_rubbish_never_raises_and_is_hardly_ever_taken(data: bytes) -> None:
    got = KissDecoder().feed(data)
    # a first frame needs a second: one chance in 65 536 an offset
    assert len(got) <= len(data) // 10
    for telemetry in got:
        assert 0.0 <= telemetry.voltage_v <= 655.35
