"""How long one row (one sensor, one cycle) takes to synthesise: the goal is 50 us with ten obstacles."""

from time import process_time
from typing import Any

import numpy as np
import pytest

from saranga.echo import load_sonar
from sitl.acoustics.atmosphere import StandardAir
from sitl.acoustics.shield import load_shield
from sitl.acoustics.sonar import AcousticModel
from sitl.primitives import Primitives, facet_row
from sitl.rig import VirtualRig
from sitl.shapes.box import Box
from sitl.shapes.cylinder import Cylinder

GEOMETRY = load_sonar("triple")
POSE = (np.array([0.0, 0.0, -1.0]), np.array([1.0, 0, 0, 0]), np.array([1.0, 0, 0]), np.full(4, 1.13))
GROUND = Primitives.of(facets=[facet_row(np.zeros(3), np.eye(3)[1], np.eye(3)[0], 10.0, 10.0, 0.9)])


def scene(kind: str, count: int = 10) -> Primitives:
    """Obstacles over the first five metres, a third of them within the record, and the ground."""
    parts = [GROUND]
    for k in range(count):
        x, y = 0.6 + 5.0 / count * k, 0.7 * np.sin(2.4 * k)
        if kind == "poles":
            parts.append(Cylinder(x_m=x, y_m=y, diameter_m=0.06, height_m=1.8).primitives())
        else:
            parts.append(Box(x_m=x, y_m=y, length_m=0.3, width_m=0.2, height_m=1.3, yaw_deg=17.0 * k).primitives())
    if kind == "boxes and poles":
        parts += [Cylinder(x_m=0.8 + 0.5 * k, y_m=0.6, diameter_m=0.05, height_m=1.8).primitives() for k in range(10)]
    return Primitives.concatenate(parts)


@pytest.mark.parametrize("kind", ["poles", "boxes", "boxes and poles"])
def test_rows(benchmark: Any, kind: str) -> None:
    primitives = scene(kind)
    model = AcousticModel(primitives, StandardAir(), GEOMETRY, load_shield("foam"), 1)
    benchmark.extra_info |= {"rows a call": len(GEOMETRY.roles), "primitives": len(primitives)}
    records = benchmark(model.cycle, *POSE, 0)
    assert len(model.arrivals("left", *POSE[:3])) >= 3
    assert set(records) == set(GEOMETRY.roles)
    if benchmark.stats is not None:
        obstacles = 20 if kind == "boxes and poles" else 10
        us_a_row = benchmark.stats.stats.min / len(GEOMETRY.roles) * 1e6
        benchmark.extra_info |= {"us a row": round(us_a_row, 1), "goal, us": 5 * obstacles}
        print(f"\n{kind}: {us_a_row:.1f} us a row (goal {5 * obstacles})")


def test_time_grows_no_faster_than_obstacles_and_not_with_history(benchmark: Any) -> None:
    def us_a_row(model: AcousticModel, first: int) -> float:
        times = []
        for k in range(first, first + 400):
            start = process_time()
            model.cycle(*POSE, 25_600 * k)
            times.append(process_time() - start)
        return 1e6 * float(np.median(times)) / len(GEOMETRY.roles)

    shield = load_shield("foam")
    models = {n: AcousticModel(scene("poles", n), StandardAir(), GEOMETRY, shield, 1) for n in (10, 20, 40)}
    for model in models.values():
        model.cycle(*POSE, 0)
    spent = benchmark.pedantic(lambda: {n: us_a_row(model, 0) for n, model in models.items()}, rounds=1)
    late = us_a_row(models[10], 1_000_000)
    benchmark.extra_info |= {f"us a row, {n} poles": round(us, 1) for n, us in spent.items()}
    benchmark.extra_info["us a row, 10 poles, after a million cycles"] = round(late, 1)
    assert spent[20] < 2.4 * spent[10] and spent[40] < 4.8 * spent[10]
    assert late < 1.5 * spent[10]


def test_rows_as_wire_bytes(benchmark: Any) -> None:
    model = AcousticModel(scene("poles"), StandardAir(), GEOMETRY, load_shield("foam"), 1)
    rig = VirtualRig(model, GEOMETRY)
    assert len(benchmark(rig.cycle, 0, 0, *POSE)) > 3 * 256 * 4
