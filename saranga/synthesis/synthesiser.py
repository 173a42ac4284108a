"""Training and evaluation pairs, any number, the same for the same (recipe, seed, scene, sensor)."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saranga.echo import HISTORY_ROWS, RANGE_COLUMNS, ROLES
from saranga.errors import UsageError
from saranga.resample import sound_speed_m_s
from saranga.sonar_geometry import SonarGeometry, load_sonar
from saranga.synthesis import scene as fields
from saranga.synthesis.noise_bank import NoiseBank, modelled_bank, recorded_bank
from saranga.synthesis.numbers import Numbers, numbers
from saranga.synthesis.recipe import MOST_OBSTACLES, Recipe
from saranga.synthesis.render import fill_scenes
from saranga.synthesis.responses import Responses, band_edges_hz, build_responses
from saranga.synthesis.scene import OBSTACLE_FIELDS, SCENE_FIELDS

WHITE_ROWS = 512
Images = NDArray[np.float32]


def truth_dtype(roles: int) -> np.dtype[Any]:
    """What is known of a scene; obstacles beyond `obstacles` have kind -1.

    Everything is of the newest cycle. `range_m` is from the middle of left and right sensor to the nearest surface at
    the trigger, `azimuth_rad` positive right, `elevation_rad` positive down, `closing_m_s` positive when coming
    nearer; `path_m` is the way of the sound to each sensor at the trigger; `snr_db` is each echo's peak and `psnr_db`
    the strongest one's at the transmitter over the noise's RMS |IQ|; `psnr_image_db` the same with the strongest of
    all cycles. -99 dB: no echo. `noise_model` 0 bank, 1 speckle; `noise_rms` in full scales (before "free" scaling);
    `first_row` is where the history begins.
    """
    each = (MOST_OBSTACLES,)
    return np.dtype([
        ("scene", "i8"), ("obstacles", "i4"), ("path", "i4"), ("noise_model", "i4"), ("band", "i4"),
        ("psnr_db", "f4"), ("psnr_image_db", "f4"), ("noise_rms", "f4"), ("first_row", "i4"),
        ("kind", "i4", each), ("range_m", "f4", each), ("azimuth_rad", "f4", each), ("elevation_rad", "f4", each),
        ("closing_m_s", "f4", each), ("size", "f4", each), ("response", "i4", each),
        ("path_m", "f4", (roles, MOST_OBSTACLES)), ("snr_db", "f4", (roles, MOST_OBSTACLES)),
    ])


@dataclass(frozen=True, eq=False)
class Batch:
    """`images` and `labels` float32 (K, R, M, N), newest row last; `truth` (K,); `iq` complex64 or None."""

    images: Images
    labels: Images
    truth: NDArray[Any]
    iq: NDArray[np.complex64] | None


class Synthesiser:
    """Draws scenes from a recipe.

    One instance may be used by several threads at once: the kernels let go of the interpreter lock, and nothing is
    changed by drawing.

    Args:
        recipe: see `load_recipe`.
        seed: 0..2^63-1. Scenes of different seeds have nothing in common.
        roles: sensors to draw; None is all of the recipe's sonar. A sensor's images do not depend on the others.
        noise: receive-only recordings in place of the modelled bank.

    Raises:
        UsageError: a role the sonar lacks, a bad seed, or unreadable recordings.
    """

    def __init__(self, recipe: Recipe, seed: int, roles: Sequence[str] | None = None,
                 noise: Sequence[Path] = ()) -> None:
        if not 0 <= seed < 2**63:
            raise UsageError(f"seed is {seed}: it must be in 0..2^63-1")
        self.recipe, self.seed = recipe, seed
        self.geometry: SonarGeometry = load_sonar(recipe["recipe"]["sonar"])
        self.roles: tuple[str, ...] = tuple(roles) if roles is not None else self.geometry.roles
        for role in self.roles:
            if role not in self.geometry.positions_m:
                raise UsageError(f"sonar {self.geometry.name!r} has no {role!r} sensor: it has "
                                 f"{', '.join(self.geometry.roles)}")
        if not self.roles or len(set(self.roles)) != len(self.roles):
            raise UsageError(f"roles are {list(self.roles)}: name each wanted sensor once")
        transmitter = self.geometry.transmitter
        heard = (transmitter, *(role for role in self.roles if role != transmitter))
        low_hz, high_hz = recipe["echo"]["bandwidth_hz"]
        bandwidths = band_edges_hz(low_hz, high_hz, recipe["echo"]["bands"])
        c = sound_speed_m_s(recipe["air"]["temperature_c"])
        self.responses: Responses = build_responses(recipe["echo"]["responses"], bandwidths, c,
                                                    recipe["label"]["merge_level"], self.geometry.bandwidth_hz)
        self.bank: NoiseBank = (recorded_bank(noise, c) if noise
                                else modelled_bank(bandwidths, recipe["noise"]["bank_rows"], c))
        self.numbers: Numbers = numbers(recipe, self.geometry, heard, bandwidths)
        self._white = modelled_bank([float("inf")], WHITE_ROWS, c)
        self._sensors = np.array([heard.index(role) for role in self.roles])
        self._channels = np.array([ROLES.index(role) for role in self.roles])

    def fill(self, first: int, images: Images, labels: Images,
             iq: NDArray[np.complex64] | None = None) -> NDArray[Any]:
        """Write scenes `first`, `first` + 1, ... into arrays that exist; returns their truth, (K,) of `truth_dtype`.

        Args:
            first: number of the first scene, 0 or more.
            images, labels: float32, (K, R, M, N), C-contiguous.
            iq: complex64 of the same shape, for denoisers and disparities that need phase.
        """
        shape = (len(images), len(self.roles), HISTORY_ROWS, RANGE_COLUMNS)
        for name, array, dtype in (("images", images, np.float32), ("labels", labels, np.float32),
                                   ("iq", iq, np.complex64)):
            if array is not None and (array.shape != shape or array.dtype != dtype or not array.flags.c_contiguous):
                raise ValueError(f"{name} is {array.dtype} {array.shape}; give C-contiguous {dtype.__name__} {shape}")
        if first < 0:
            raise ValueError(f"first is {first}; scenes are numbered from 0")
        count, heard = len(images), len(self.numbers.sensors)
        scenes, obstacles = np.empty((count, SCENE_FIELDS)), np.empty((count, MOST_OBSTACLES, OBSTACLE_FIELDS))
        paths, snrs = np.empty((count, heard, MOST_OBSTACLES)), np.empty((count, heard, MOST_OBSTACLES))
        r = self.responses
        tables = (r.re, r.im, r.lead, r.rise, r.extent, r.size)
        target = iq if iq is not None else np.empty((0, 0, 0, 0), dtype=np.complex64)
        fill_scenes(self.numbers, np.uint64(self.seed), first, self._sensors, self._channels,
                    tables, _plain(self.bank), _plain(self._white), images, labels, target, scenes, obstacles, paths,
                    snrs)
        return self._truth(first, scenes, obstacles, paths, snrs)

    def batch(self, first: int, count: int, iq: bool = False) -> Batch:
        """`count` scenes from `first` on, in new arrays."""
        shape = (count, len(self.roles), HISTORY_ROWS, RANGE_COLUMNS)
        images, labels = np.empty(shape, dtype=np.float32), np.empty(shape, dtype=np.float32)
        complex_images = np.empty(shape, dtype=np.complex64) if iq else None
        truth = self.fill(first, images, labels, complex_images)
        return Batch(images, labels, truth, complex_images)

    def provenance(self) -> dict[str, Any]:
        """What a data set or a trained network must carry to be made again."""
        return {"recipe": self.recipe.name, "recipe_sha256": self.recipe.sha256, "seed": self.seed,
                "roles": list(self.roles), "noise": list(self.bank.source), "sonar": self.geometry.name}

    def _truth(self, first: int, scenes: NDArray[np.float64], obstacles: NDArray[np.float64],
               paths: NDArray[np.float64], snrs: NDArray[np.float64]) -> NDArray[Any]:
        truth = np.zeros(len(scenes), dtype=truth_dtype(len(self.roles)))
        truth["scene"] = first + np.arange(len(scenes))
        for name, index in (("obstacles", fields.COUNT), ("path", fields.PATH), ("noise_model", fields.MODEL),
                            ("band", fields.BAND), ("psnr_db", fields.PSNR), ("psnr_image_db", fields.PSNR_IMAGE),
                            ("noise_rms", fields.LEVEL), ("first_row", fields.FIRST_ROW)):
            truth[name] = scenes[:, index]
        for name, index in (("kind", fields.KIND), ("range_m", fields.RANGE), ("azimuth_rad", fields.AZIMUTH),
                            ("elevation_rad", fields.ELEVATION), ("closing_m_s", fields.CLOSING),
                            ("size", fields.SIZE)):
            truth[name] = obstacles[..., index]
        truth["response"] = obstacles[..., fields.VARIANT] % len(self.responses.names)
        truth["path_m"], truth["snr_db"] = paths[:, self._sensors], snrs[:, self._sensors]
        return truth


def _plain(bank: NoiseBank) -> tuple[Any, ...]:
    return bank.re, bank.im, bank.starts, bank.banded
