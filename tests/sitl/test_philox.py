"""Noise draws are NumPy's Philox, number for number."""

import numpy as np
import pytest

from sitl.acoustics.philox import philox


@pytest.mark.parametrize("key", [0, 1, 12_345_678_901_234_567_890, 2**64 - 1])
@pytest.mark.parametrize("t_us", [0, 25_600, 2**40 + 5])
def test_philox_is_numpys(key: int, t_us: int) -> None:
    for count in (1, 4, 13):
        out = np.zeros(count, dtype=np.uint64)
        philox(np.uint64(key), np.array([0, 0x5A7A, 0, t_us], dtype=np.uint64), out)
        np.testing.assert_array_equal(out, np.random.Philox(key=key, counter=[0, 0x5A7A, 0, t_us]).random_raw(count))
