"""Is a run worse than an earlier one? Pairs of flights, measures of them, tests with intervals, one verdict."""
