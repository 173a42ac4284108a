"""Images denoised in threads: the same edges as one after the other, whatever the number of sensors and threads."""

import threading

import numpy as np
import pytest
from synthetic_images import Reflector, SyntheticImage, image

from saranga.denoise import load_denoiser
from saranga.side_by_side import SideBySide, more_of


class Notes:
    """Edges that tell the image; notes in which thread it was called, and fails for one image."""

    name, threshold, edge_offset_m = "notes", 0.5, 0.0

    def __init__(self, fails_on: SyntheticImage | None = None) -> None:
        self.threads: list[str] = []
        self._fails_on = fails_on

    def __call__(self, image: SyntheticImage) -> np.ndarray:
        self.threads.append(threading.current_thread().name)
        if image is self._fails_on:
            raise ValueError("broken")
        return np.abs(image.iq)


def images() -> dict[str, SyntheticImage]:
    rng = np.random.default_rng(3)
    return {role: image([Reflector(0.5 + 0.3 * k, 0.5)], 12.0, rng) for k, role in enumerate(("left", "right", "down"))}


@pytest.mark.parametrize("threads", [1, 2, 3, 5])
def test_every_image_once_and_in_its_order(threads: int) -> None:
    given = images()
    denoisers = [Notes() for _ in range(threads)]
    rows = SideBySide(denoisers)(given)
    assert list(rows) == list(given)
    for role, seen in given.items():
        assert np.array_equal(rows[role], np.abs(seen.iq[-1]))
    assert sum(len(denoiser.threads) for denoiser in denoisers) == 3
    own = {1: 3, 2: 2}.get(threads, 1)
    assert denoisers[0].threads == [threading.current_thread().name] * own
    assert all(name.startswith("denoise") for denoiser in denoisers[1:] for name in denoiser.threads)


def test_the_network_sees_the_same_in_a_thread() -> None:
    given = images()
    one = SideBySide([load_denoiser("saranga")])(given)
    two = SideBySide([load_denoiser("saranga"), *more_of("saranga", 2)])
    for _ in range(5):
        again = two(given)
        assert all(np.array_equal(again[role], one[role]) for role in given)
    assert max(row.max() for row in one.values()) > 0.5


@pytest.mark.parametrize("at", ["left", "right"])
def test_an_error_in_either_thread_is_the_callers(at: str) -> None:
    given = images()
    both = SideBySide([Notes(given[at]), Notes(given[at])])
    for _ in range(2):
        with pytest.raises(ValueError, match="broken"):
            both(given)
    assert list(both({"down": given["down"]})) == ["down"]


def test_who_gets_helpers() -> None:
    assert more_of("tbd", 1) == [] and more_of("some.module:Mine", 2) == []
    assert [denoiser.name for denoiser in more_of("tbd", 3)] == ["tbd", "tbd"]
    with pytest.raises(ValueError, match="threads is 0"):
        more_of("tbd", 0)
