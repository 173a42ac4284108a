"""All that one receiver hears after a trigger, in one call: straight echoes, rough surfaces, bounces."""

from numba import njit

from sitl.acoustics.bounce import bounces
from sitl.acoustics.scatter import scatter
from sitl.acoustics.tracing import near, trace

BEYOND_M = 0.2
"""Bodies are looked for this far beyond half the longest path: sensors are up to this far apart."""


@njit(cache=True)
def hear(facets, cylinders, spheres, edges, patches, points, tx, rx, rotation, velocity, setting, grid, floor, out):  # type: ignore[no-untyped-def]
    """Fills rows of `out` (K, ARRIVAL_COLUMNS) and returns how many; arguments as `tracing.trace` and `scatter`."""
    near_facets, near_cylinders = near(facets, cylinders, tx, 0.5 * setting[4] + BEYOND_M)
    n = trace(facets, cylinders, spheres, edges, near_facets, near_cylinders, tx, rx, rotation, velocity, setting, grid,
              floor, out)
    if patches.shape[0] > 0:
        n = scatter(patches, points, facets, cylinders, near_facets, near_cylinders, tx, rx, rotation, velocity,
                    setting, grid, floor, out, n)
    return bounces(facets, cylinders, near_facets, near_cylinders, tx, rx, rotation, velocity, setting, grid, floor,
                   out, n)
