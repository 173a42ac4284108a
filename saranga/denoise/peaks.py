"""Writing a peak between two columns into an edge row so that `saranga.localise.edges` reads its exact position."""

from numba import njit


@njit(cache=True)
def put_peak(row, position, strength):  # type: ignore[no-untyped-def]
    """Set the two columns about `position` so that their centroid is `position` and their larger value `strength`."""
    first = int(position)
    if first < 0 or first + 1 >= row.size:
        return
    share = position - first
    if share <= 0.5:
        row[first] = strength
        row[first + 1] = strength * share / (1.0 - share)
    else:
        row[first] = strength * (1.0 - share) / share
        row[first + 1] = strength
