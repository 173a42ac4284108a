"""Philox 4x64-10 (Salmon et al., SC'11), number for number NumPy's `Philox(key, counter).random_raw`, without the 15 us
that making a NumPy generator takes: every cycle of echoes has a counter of its own."""

import numpy as np
from numba import njit

ROUNDS = 10
_M0, _M1 = np.uint64(0xD2E7470EE14C6C93), np.uint64(0xCA5A826395121157)
_W0, _W1 = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBB67AE8584CAA73B)
_LOW, _32 = np.uint64(0xFFFFFFFF), np.uint64(32)


@njit(cache=True)
def _high(a, b):  # type: ignore[no-untyped-def]
    """Upper 64 bits of the product."""
    a0, a1, b0, b1 = a & _LOW, a >> _32, b & _LOW, b >> _32
    middle = a1 * b0 + ((a0 * b0) >> _32)
    return a1 * b1 + (middle >> _32) + ((a0 * b1 + (middle & _LOW)) >> _32)


@njit(cache=True)
def philox(key, counter, out):  # type: ignore[no-untyped-def]
    """Fill `out` (K,) uint64 with the numbers that NumPy draws first from this key (< 2^64) and counter (4,) uint64.

    NumPy steps the counter before each block of four; its lowest word must not run over within `out`.
    """
    for block in range((out.shape[0] + 3) // 4):
        c0, c1, c2, c3 = counter[0] + np.uint64(block + 1), counter[1], counter[2], counter[3]
        k0, k1 = np.uint64(key), np.uint64(0)
        for _ in range(ROUNDS):
            c0, c1, c2, c3 = _high(_M1, c2) ^ c1 ^ k0, _M1 * c2, _high(_M0, c0) ^ c3 ^ k1, _M0 * c0
            k0 += _W0
            k1 += _W1
        at = 4 * block
        for k, word in enumerate((c0, c1, c2, c3)):
            if at + k < out.shape[0]:
                out[at + k] = word
