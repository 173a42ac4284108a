"""A recipe and a sonar as the plain numbers that the kernels read."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from saranga.echo import FULL_SCALE, HISTORY_ROWS
from saranga.resample import COLUMN_M, RANGE_COLUMNS, sound_speed_m_s
from saranga.sonar_geometry import SonarGeometry
from saranga.synthesis.paths import KINDS, PATHS
from saranga.synthesis.recipe import Recipe

Pair = tuple[float, float]


class Numbers(NamedTuple):
    """SI units, angles in radians; pairs are (low, high); `*_sum` are cumulative weights that end at 1."""

    path_sum: NDArray[np.float64]
    count_sum: NDArray[np.float64]
    kind_sum: NDArray[np.float64]
    closing: Pair
    sideways: Pair
    acceleration: Pair
    radius: Pair
    sway: Pair
    sway_hz: Pair
    jitter: Pair
    doppler: bool
    cosine_a: Pair
    cosine_b: Pair
    cosine_omega: Pair
    range_m: Pair
    azimuth: Pair
    elevation: Pair
    cylinder: Pair
    point: Pair
    edge_angle: Pair
    reflectivity_db: Pair
    fading_db: Pair
    partial: float
    absorption_db: Pair
    directivity: bool
    bandwidths: NDArray[np.float64]
    responses: int
    psnr_db: Pair
    psnr_image: bool
    level: Pair
    drift_db: Pair
    own_band: float
    speckle: float
    multiplicative: Pair
    lost: float
    start: float
    ring: float
    ring_db: Pair
    free_scale: bool
    limit: float
    merge: bool
    merge_level: float
    blur: float
    least_snr: float
    c: float
    fop_hz: float
    wavenumber: float
    reach_h: float
    reach_v: float
    cycle_s: float
    column_m: float
    rows: int
    columns: int
    sensors: NDArray[np.float64]
    ring_profile: NDArray[np.float32]


def sensor_positions(geometry: SonarGeometry, roles: Sequence[str]) -> NDArray[np.float64]:
    """(S, 3) from the middle of left and right sensor."""
    positions = {role: np.array(p) for role, p in geometry.positions_m.items()}
    centre = 0.5 * (positions["left"] + positions["right"])
    return np.array([positions[role] - centre for role in roles])


def ring_down(geometry: SonarGeometry, c_m_s: float) -> NDArray[np.float32]:
    """(columns,) in full scales: a resonator of bandwidth B decays as exp(-pi B t), here to the quiet floor at
    `ring_down_samples`; it never exceeds the saturation, and is 0 once below a hundredth of the floor."""
    t = 2.0 * COLUMN_M * np.arange(RANGE_COLUMNS) / c_m_s
    end_s = geometry.ring_down_samples / geometry.iq_rate_hz
    height = geometry.quiet_floor_counts * np.exp(math.pi * geometry.bandwidth_hz * (end_s - t))
    height[height < 0.01 * geometry.quiet_floor_counts] = 0.0
    return (np.minimum(height, geometry.saturation_counts) / FULL_SCALE).astype(np.float32)


def _cumulative(weights: Sequence[float]) -> NDArray[np.float64]:
    total = np.cumsum(np.array(weights, dtype=np.float64))
    return total / total[-1]


def _radians(pair: Pair) -> Pair:
    return (math.radians(pair[0]), math.radians(pair[1]))


def numbers(recipe: Recipe, geometry: SonarGeometry, roles: Sequence[str], bandwidths_hz: Sequence[float]) -> Numbers:
    """Lower `recipe` for sensors `roles`, the transmitter first."""
    motion, cosine, obstacles = recipe["motion"], recipe["cosine"], recipe["obstacles"]
    air, noise, image, label = recipe["air"], recipe["noise"], recipe["image"], recipe["label"]
    c = sound_speed_m_s(air["temperature_c"])
    wavenumber = 2.0 * math.pi * geometry.fop_hz / c
    level = tuple(v / FULL_SCALE for v in noise["level_counts"])
    return Numbers(
        path_sum=_cumulative([recipe["paths"][name] for name in PATHS]),
        count_sum=_cumulative(obstacles["count_weights"]),
        kind_sum=_cumulative([recipe["kinds"][name] for name in KINDS]),
        closing=motion["closing_m_s"], sideways=motion["sideways_m_s"], acceleration=motion["acceleration_m_s2"],
        radius=motion["turn_radius_m"], sway=motion["sway_m"], sway_hz=motion["sway_hz"], jitter=motion["jitter_m"],
        doppler=motion["doppler"], cosine_a=cosine["a_m"], cosine_b=cosine["b_m"], cosine_omega=cosine["omega_rad_s"],
        range_m=obstacles["range_m"], azimuth=_radians(obstacles["azimuth_deg"]),
        elevation=_radians(obstacles["elevation_deg"]), cylinder=obstacles["cylinder_radius_m"],
        point=obstacles["point_radius_m"], edge_angle=_radians(obstacles["edge_angle_deg"]),
        reflectivity_db=obstacles["reflectivity_db"], fading_db=obstacles["fading_db"],
        partial=obstacles["partial_probability"], absorption_db=air["absorption_db_m"], directivity=air["directivity"],
        bandwidths=np.array(bandwidths_hz, dtype=np.float64), responses=len(recipe["echo"]["responses"]),
        psnr_db=noise["psnr_db"], psnr_image=noise["psnr_reference"] == "image", level=(level[0], level[1]),
        drift_db=noise["drift_db"], own_band=noise["own_band_probability"], speckle=noise["speckle_probability"],
        multiplicative=noise["speckle_multiplicative"], lost=recipe["rows"]["lost_probability"],
        start=recipe["rows"]["start_probability"], ring=recipe["ring_down"]["probability"],
        ring_db=recipe["ring_down"]["gain_db"], free_scale=image["scale"] == "free",
        limit=geometry.saturation_counts / FULL_SCALE if image["saturation"] else math.inf,
        merge=label["rule"] == "merged", merge_level=label["merge_level"], blur=label["blur_columns"],
        least_snr=10.0 ** (label["least_snr_db"] / 20.0),
        c=c, fop_hz=geometry.fop_hz, wavenumber=wavenumber, reach_h=wavenumber * geometry.a_h_m,
        reach_v=wavenumber * geometry.a_v_m, cycle_s=geometry.cycle_us * 1e-6, column_m=COLUMN_M, rows=HISTORY_ROWS,
        columns=RANGE_COLUMNS, sensors=sensor_positions(geometry, roles), ring_profile=ring_down(geometry, c),
    )


