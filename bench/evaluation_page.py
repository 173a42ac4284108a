"""The page of a comparison of denoisers: one HTML file that needs nothing else."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from bench import evaluation_figures as figures
from bench.page import write_page_file
from saranga.errors import UsageError

RESULTS, EXAMPLES, PAGE = "evaluation.json", "examples.npz", "evaluation.html"
LEADER = "saranga"
MOST_EXAMPLES = 12


def is_evaluation(folder: Path) -> bool:
    """Whether `folder` holds a comparison rather than a run."""
    return (folder / RESULTS).is_file()


def write_evaluation_page(folder: Path) -> Path:
    """Write `evaluation.html` beside `evaluation.json` and `examples.npz`.

    Raises:
        UsageError: the results are missing, damaged or of a recording. BenchError: the page cannot be written.
    """
    tree = _results(folder / RESULTS)
    kinds = list(dict.fromkeys(kind for m in tree["methods"].values() for kind in m["sets"]))
    names = figures.ordered(list(tree["methods"]))
    middle = _middle_psnr(tree, "single" if "single" in kinds else kinds[0]) if kinds else None
    curves = [("At equal false alarms", "Thresholds set so that every method raises 0.01 false edges a frame.",
               figures.rate_curves(tree, "hit_rate_equal_false_alarms")),
              ("At the method's own threshold", "What flies.", figures.rate_curves(tree, "hit_rate")),
              ("Strongest edge", "Whatever its strength: the best guess, without saying how sure.",
               figures.rate_curves(tree, "hit_rate_strongest"))] if kinds else []
    return write_page_file(
        folder / PAGE, "evaluation_page.html.j2", {"percent": _percent, "number": _number, "span": _span},
        tree=tree, names=names,
        every={**{n: tree["methods"][n] for n in names}, **tree["baseline"]}, curves=curves,
        paper=[(figures.KIND_TITLES.get(k, k), figures.paper_curves(tree, k)) for k in kinds if k != "constant"],
        cost=figures.cost(tree, "single", middle) if middle is not None and "single" in kinds else "",
        cost_psnr=middle, kinds=kinds, kind_titles=figures.KIND_TITLES, examples=_examples(folder / EXAMPLES),
        lead=_lead(tree), colours=figures.colours(list(tree["methods"])))


def _results(path: Path) -> dict[str, Any]:
    try:
        tree = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise UsageError(f"{path} cannot be read ({error}): make it with python -m saranga evaluate --out DIR"
                         ) from error
    if not isinstance(tree, dict) or not {"methods", "baseline", "psnr", "sets"} <= tree.keys():
        raise UsageError(f"{path} holds no comparison on common sets: make one with python -m saranga evaluate "
                         "--out DIR (results of --recording have no page)")
    return tree


def _lead(tree: dict[str, Any]) -> str:
    """One sentence: who is ahead where, by intervals."""
    if LEADER not in tree["methods"]:
        return f"{len(tree['methods'])} methods compared."
    ahead = level = behind = 0
    for kind, points in tree["methods"][LEADER]["sets"].items():
        for psnr, mine in points.items():
            rivals = [m["sets"].get(kind, {}).get(psnr) for n, m in tree["methods"].items()
                      if not n.startswith(LEADER)]
            best = max((r["hit_rate_equal_false_alarms"] for r in rivals
                        if r and r["hit_rate_equal_false_alarms"] is not None), default=None)
            rate = mine["hit_rate_equal_false_alarms"]
            if best is None or rate is None:
                continue
            low, high = mine["hit_rate_equal_false_alarms_interval"]
            ahead += low > best
            behind += high < best
            level += low <= best <= high
    total = ahead + level + behind
    return (f"At equal false alarms the network is ahead of its best rival at {ahead} of {total} points "
            f"(set and PSNR) beyond the 95 % interval of its own rate, level at {level}, behind at {behind}.")


def _middle_psnr(tree: dict[str, Any], kind: str) -> str | None:
    known = {p for m in tree["methods"].values() for p in m["sets"].get(kind, {})}
    return min(known, key=lambda p: abs(float(p) - 5.0)) if known else None


def _examples(path: Path) -> list[dict[str, Any]]:
    if not path.is_file():
        return []
    try:
        with np.load(path) as data:
            arrays = {key: data[key] for key in data.files}
    except (OSError, ValueError, KeyError) as error:
        raise UsageError(f"{path} cannot be read: {error}; run the comparison again") from error
    out = []
    for k in range(min(len(arrays["images"]), MOST_EXAMPLES)):
        out.append({
            "title": f"{figures.KIND_TITLES.get(str(arrays['kind'][k]), arrays['kind'][k])}, "
                     f"{float(arrays['psnr_db'][k]):g} dB",
            "svg": figures.example(arrays["images"][k], arrays["edges"][k], [str(m) for m in arrays["methods"]],
                                   arrays["thresholds"], arrays["offsets_m"], arrays["truth_range_m"][k])})
    return out


def _percent(value: float | None) -> str:
    return "–" if value is None else f"{100 * value:.0f}"


def _number(value: float | None, digits: int = 2, times: float = 1.0) -> str:
    return "–" if value is None else f"{times * value:.{digits}f}"


def _span(interval: list[float | None], times: float = 1.0, digits: int = 0) -> str:
    low, high = interval
    return "" if low is None or high is None else f"{times * low:.{digits}f}–{times * high:.{digits}f}"
