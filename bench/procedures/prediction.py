"""From an insertion loss to a detection range, by the sonar equation of the simulator's own laws.

PSNR(r) = anchor + 20 log10(echo(r) / pole(1 m)) - 2 alpha (r - 1 m) + loss. The anchor is the paper's: -4.9 dB for a
60 mm pole at 1 m, unshielded, at hover. Two thresholds: the paper's own (unshielded, that pole was seen to 1 m, so
-4.9 dB is just enough), and the PSNR from which the shipped network finds 9 in 10 obstacles in single images.
"""

import itertools
import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from saranga.errors import UsageError
from saranga.fixtures import fixture_dir
from sitl.acoustics.atmosphere import StandardAir, atmosphere
from sitl.acoustics.echoes import cylinder_amplitude, plane_amplitude
from sitl.acoustics.rotor_noise import ANCHOR_PSNR_DB, ANCHOR_RADIUS_M, ANCHOR_RANGE_M

FOP_HZ = 53_000.0
NEAREST_M, FARTHEST_M = 0.1, 10.0
TARGETS: dict[str, Callable[[float], float]] = {
    "60 mm pole": lambda r: float(cylinder_amplitude(r, r, ANCHOR_RADIUS_M, 1.0)),
    "25 mm pole": lambda r: float(cylinder_amplitude(r, r, 0.0125, 1.0)),
    "flat": lambda r: float(plane_amplitude(r, r)),
}
RECORD_M = 1.66
"""Length of a record: what lies farther is heard, but not recorded."""


@dataclass(frozen=True)
class Threshold:
    """A PSNR that suffices, and whose word that is."""

    name: str
    psnr_db: float
    source: str




def thresholds() -> tuple[Threshold, ...]:
    """The paper's, and that of the shipped network where its metrics are there."""
    paper = Threshold("as in the paper", ANCHOR_PSNR_DB, "unshielded, the 60 mm pole at -4.9 dB was seen to 1 m")
    network = _network_threshold_db()
    return (paper,) if network is None else (paper, Threshold(
        "shipped network, 9 of 10 images", network, "hit rate 0.9 at its own threshold, one obstacle of constant "
                                                    "strength (fixtures/models/saranga.json)"))


def _network_threshold_db(rate: float = 0.9) -> float | None:
    """PSNR at which the shipped network's hit rate passes `rate`, straight between its measured points."""
    try:
        metrics = json.loads((fixture_dir() / "models" / "saranga.json").read_text(encoding="utf-8"))["metrics"]
        points = sorted((float(p), float(s["hit_rate"])) for p, s in metrics["int8"]["constant"].items())
    except (OSError, ValueError, KeyError, TypeError, UsageError):
        return None
    for (p0, r0), (p1, r1) in itertools.pairwise(points):
        if r0 < rate <= r1:
            return p0 + (p1 - p0) * (rate - r0) / (r1 - r0)
    return None


def psnr_db(target: str, range_m: float, loss_db: float) -> float:
    """PSNR of a target straight ahead at hover, behind a shield that takes `loss_db`."""
    alpha_db_m = atmosphere(FOP_HZ, StandardAir()).absorption_db_m
    pole = TARGETS["60 mm pole"](ANCHOR_RANGE_M)
    spreading = 20.0 * math.log10(TARGETS[target](range_m) / pole)
    return ANCHOR_PSNR_DB + spreading - 2.0 * alpha_db_m * (range_m - ANCHOR_RANGE_M) + loss_db


def detection_range_m(target: str, loss_db: float, threshold_db: float) -> float:
    """Farthest range at which the PSNR reaches a threshold, in 0.1..10 m."""
    from scipy.optimize import brentq

    def excess(r: float) -> float:
        return psnr_db(target, r, loss_db) - threshold_db

    if excess(NEAREST_M) <= 0.0:
        return NEAREST_M
    return FARTHEST_M if excess(FARTHEST_M) >= 0.0 else float(brentq(excess, NEAREST_M, FARTHEST_M))


def predicted_ranges(loss_db: float, low_db: float | None, high_db: float | None) -> dict[str, Any]:
    """Threshold name to target to {value, interval} in metres."""
    return {t.name: {target: {
        "value": round(detection_range_m(target, loss_db, t.psnr_db), 3),
        "interval": None if low_db is None or high_db is None else
        [round(detection_range_m(target, b, t.psnr_db), 3) for b in (low_db, high_db)]}
        for target in TARGETS} for t in thresholds()}
