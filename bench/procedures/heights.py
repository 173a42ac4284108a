"""The optimum-height question of the paper's Fig. 6 F: the lowest shield that no higher one betters by much.

The paper reads 63.5 mm off its curves. Here a height is "enough" when every higher shield of the sweep takes at most
`WORTH_DB` more with the upper end of its paired interval, "too low" when some higher one takes more with the lower end,
and otherwise the blocks do not tell.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from bench.procedures.insertion_loss import Blocks, insertion_loss

WORTH_DB = 1.0
PAPER_HEIGHT_M = 0.0635


@dataclass(frozen=True)
class HeightAnswer:
    """`optimum_m`: the lowest that is enough, None where none is shown to be; `by_height`: each one's answer."""

    optimum_m: float | None
    by_height: dict[float, str]
    sentence: str


def optimum_height(by_height: Mapping[float, Blocks], worth_db: float = WORTH_DB) -> HeightAnswer:
    """The answer from the blocks of each height (metres)."""
    heights = sorted(by_height)
    answers: dict[float, str] = {}
    for height in heights[:-1]:
        gains = [insertion_loss("", by_height[height], by_height[h]) for h in heights if h > height]
        found = [g.overall for g in gains if g is not None]
        if len(found) < len(gains) or any(e.low is None or e.high is None for e in found):
            answers[height] = "not told"
        elif any(e.low is not None and e.low > worth_db for e in found):
            answers[height] = "too low"
        elif all(e.high is not None and e.high <= worth_db for e in found):
            answers[height] = "enough"
        else:
            answers[height] = "not told"
    if heights:
        answers[heights[-1]] = "highest tried"
    enough = [h for h in heights if answers[h] == "enough"]
    optimum = enough[0] if enough else None
    return HeightAnswer(optimum, answers, _sentence(optimum, answers, worth_db))


def _sentence(optimum: float | None, answers: dict[float, str], worth_db: float) -> str:
    if len(answers) < 2:
        return "the optimum height needs a sweep over at least two heights"
    unsure = [h for h, a in answers.items() if a == "not told" and (optimum is None or h < optimum)]
    doubt = f"; {', '.join(f'{1e3 * h:.1f}' for h in unsure)} mm cannot be excluded" if unsure else ""
    if optimum is None:
        return (f"no height of the sweep is shown to be enough (next ones gain at most {worth_db:g} dB){doubt}: more "
                "blocks, or higher shields")
    return (f"{1e3 * optimum:.1f} mm is the lowest height that is enough: no higher one gains more than {worth_db:g} dB"
            f"{doubt} (the paper's answer is {1e3 * PAPER_HEIGHT_M:.1f} mm)")
