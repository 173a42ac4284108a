"""Beam pattern: the echo of a pole over distance and azimuth (the paper's Fig. S3), and the beam width it gives."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.procedures.echo_bench import EchoBench, Place, mean_record, sample_of_range
from bench.procedures.plan import BeamPlan
from saranga.echo import FULL_SCALE, EchoCycle, sound_speed_m_s
from saranga.pulse import pulse_peak_delay_s

TEMPERATURE_C = 20.0
SEEN_DB = 10.0
"""An echo counts as seen this far over the noise of the same mean record."""


@dataclass(frozen=True)
class BeamPoint:
    """Echo of the pole at one place: level in dB re 20 000, over the noise, and whether it was seen."""

    distance_m: float
    azimuth_deg: float
    level_db: float
    over_noise_db: float
    seen: bool
    repeat: int

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready."""
        return dict(vars(self))


def measure_beam(plan: BeamPlan, bench: EchoBench, keep: Callable[[BeamPoint], None],
                 done: frozenset[tuple[int, float, float]] = frozenset()) -> list[BeamPoint]:
    """Visit every place in an order drawn by the plan's seed; `keep` is called after each (journal first)."""
    found = []
    for repeat, place in places(plan):
        if (repeat, place.distance_m, place.azimuth_deg) in done:
            continue
        point = beam_point(bench.cycles(place, plan.rig.frames), place, plan, repeat)
        keep(point)
        found.append(point)
    return found


def places(plan: BeamPlan) -> list[tuple[int, Place]]:
    """Every place of every repeat, random by the seed."""
    rng = np.random.Generator(np.random.Philox(np.random.SeedSequence([plan.seed, 0xBEA3])))
    out = []
    for repeat in range(plan.repeats):
        every = [Place(d, a, plan.pole_diameter_m) for d in plan.distances_m for a in plan.azimuths_deg]
        out += [(repeat, every[k]) for k in rng.permutation(len(every)).tolist()]
    return out


def beam_point(cycles: list[EchoCycle], place: Place, plan: BeamPlan, repeat: int = 0) -> BeamPoint:
    """Peak of the mean record within `window_m` of where the pole stands."""
    row, rate_hz = mean_record(cycles, plan.rig.sensor)
    c = sound_speed_m_s(TEMPERATURE_C)
    # The envelope peaks a little behind the pole's surface.
    behind_m = 0.5 * c * pulse_peak_delay_s(3980.0)
    first = sample_of_range(place.distance_m + behind_m - plan.window_m, rate_hz, c)
    last = sample_of_range(place.distance_m + behind_m + plan.window_m, rate_hz, c)
    size = np.abs(row)
    window = size[max(first, 1):last + 1]
    rest = np.concatenate([size[len(size) // 8:max(first, len(size) // 8)], size[last + 1:]])
    noise = float(np.sqrt(np.mean(rest**2))) if rest.size else math.nan
    peak = float(window.max()) if window.size else 0.0
    over = 20.0 * math.log10(peak / noise) if noise > 0.0 and peak > 0.0 else -math.inf
    return BeamPoint(place.distance_m, place.azimuth_deg, 20.0 * math.log10(max(peak, 1e-3) / FULL_SCALE),
                     over if math.isfinite(over) else -99.0, over >= SEEN_DB, repeat)


def beam_result(points: Sequence[BeamPoint], plan: BeamPlan, origin: str) -> dict[str, Any]:
    """Pattern by distance relative to straight ahead, two-way half-power width, and the farthest seen by azimuth."""
    table: dict[float, dict[float, list[BeamPoint]]] = {}
    for p in points:
        table.setdefault(p.distance_m, {}).setdefault(p.azimuth_deg, []).append(p)
    pattern, widths = {}, {}
    for distance, row in sorted(table.items()):
        level = {a: float(np.mean([p.level_db for p in ps])) for a, ps in sorted(row.items())}
        ahead = level.get(0.0, max(level.values()))
        pattern[f"{distance:g}"] = {f"{a:g}": v - ahead for a, v in level.items()}
        widths[f"{distance:g}"] = two_way_width_deg(list(level), [v - ahead for v in level.values()])
    reach = {f"{a:g}": max((p.distance_m for p in points if p.azimuth_deg == a and p.seen), default=None)
             for a in sorted({p.azimuth_deg for p in points})}
    return {"origin": origin, "pole_diameter_m": plan.pole_diameter_m, "sensor": plan.rig.sensor,
            "points": [p.to_dict() for p in points], "pattern_db": pattern, "width_6db_deg": widths,
            "farthest_seen_m": reach, "places": len(places(plan)),
            "note": "transmit times receive: -6 dB here is -3 dB one way; a horn's 140 x 57 degrees may be either"}


def two_way_width_deg(azimuths_deg: Sequence[float], level_db: Sequence[float], fall_db: float = 6.0) -> float | None:
    """Full width where the level has fallen by `fall_db`, straight between points; None where it does not fall."""
    order = np.argsort(azimuths_deg)
    a, v = np.asarray(azimuths_deg)[order], np.asarray(level_db)[order]
    middle = int(np.argmin(np.abs(a)))
    edges = []
    for step in (1, -1):
        k = middle
        while 0 <= k + step < len(a) and v[k + step] > -fall_db:
            k += step
        if not 0 <= k + step < len(a):
            return None
        share = (v[k] + fall_db) / (v[k] - v[k + step])
        edges.append(float(a[k] + share * (a[k + step] - a[k])))
    return edges[0] - edges[1]
