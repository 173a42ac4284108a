"""`saranga-bench compare RUN BASELINE`: is a run worse than an earlier one?"""

import json
from pathlib import Path
from typing import Annotated

import typer

EXAMPLES = """\b
Examples:
  saranga-bench fly poles --trials 20                      # once: the baseline, say 3fa9
  saranga-bench fly poles --trials 20 --baseline 3fa9      # after every change of the stack
  saranga-bench compare last 3fa9                          # two runs that are flown already
  saranga-bench compare last 3fa9 --unpaired               # over different seeds
  saranga-bench campaign paper --baseline nightly/paper

FAIL: worse, surely and by more than matters. PASS: no regression shown, and the least
one that would have been. Runs over another scene, shield, sonar, airframe or firmware
are refused. docs/ci.md says how it is tested.

Exit codes: 0 PASS or MARGINAL, 1 FAIL, 2 bad input, 3 INCONCLUSIVE, 4 ERROR.
"""


def compare(
    run: Annotated[str, typer.Argument(metavar="RUN", help="`last`, an id or the start of one, or a path.")],
    baseline: Annotated[
        str, typer.Argument(metavar="BASELINE", help="The earlier run, named the same way, or a folder of runs.")
    ],
    unpaired: Annotated[bool, typer.Option("--unpaired", help="The runs flew different seeds.")] = False,
    confidence: Annotated[
        float | None, typer.Option(help="For all tests together [0.99: one false alarm in a hundred].")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
    out: Annotated[Path | None, typer.Option(help="Folder of runs [$SARANGA_BENCH_RUNS or ./runs].")] = None,
) -> None:
    """Hold a run of flights to an earlier one: regression verdict with intervals."""
    from bench.baseline.command import find_run, keep_comparison
    from bench.baseline.flights import read_flights
    from bench.baseline.report import comparison_text
    from bench.baseline.verdict import CONFIDENCE, compare_runs
    from bench.store import Store, runs_root

    store = Store(runs_root(out))
    folder = store.resolve(run)
    found = compare_runs(read_flights(folder), read_flights(find_run(baseline, store)), not unpaired,
                         CONFIDENCE if confidence is None else confidence)
    keep_comparison(folder, found)
    print(json.dumps(found.to_dict(), allow_nan=False) if as_json else comparison_text(found))
    raise typer.Exit(found.verdict.exit_code)
