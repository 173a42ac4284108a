"""Insertion loss at equal thrust: what a shield takes, 20 log10(RMS open / RMS shielded), pair by pair within a block.

Each block has its own unshielded reference, so drift from block to block cancels. Within a block both are interpolated
to common thrusts (straight lines of dB over log thrust), subtracted there, and only then averaged over blocks. The
interval is Student's over the blocks: remounting is the largest term, so frames say nothing about it.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.procedures.blocks import Estimate, blocks_needed, mean_of_blocks
from bench.procedures.fits import Points, interpolated_db

Floats = NDArray[np.float64]
GRID_POINTS = 12
SAME_DB = 1.0
"""Two shields whose difference lies within this, interval and all, count as equal."""

Blocks = Mapping[int, Points]
"""Block number to the points of one condition in it."""


@dataclass(frozen=True)
class Loss:
    """Insertion loss of one shield.

    Attributes:
        overall: mean over the common thrusts.
        thrust_n: (G,) common thrusts of all blocks.
        at: (G,) estimates there.
        at_target: at the thrust asked for, None where the sweep does not reach it in two or more blocks.
        per_block: block to mean loss, dB.
    """

    shield: str
    overall: Estimate
    thrust_n: tuple[float, ...]
    at: tuple[Estimate, ...]
    at_target: Estimate | None
    per_block: dict[int, float]


def common_thrusts(conditions: Sequence[Blocks], count: int = GRID_POINTS) -> Floats:
    """`count` thrusts, evenly spaced in their logarithm, that every block of every condition covers; empty where none.
    """
    every = [p for blocks in conditions for p in blocks.values() if len(p) >= 2]
    if not every:
        return np.zeros(0)
    low = max(float(p.thrust_n[0]) for p in every)
    high = min(float(p.thrust_n[-1]) for p in every)
    return np.geomspace(low, high, count) if high > low else np.zeros(0)


def loss_db(reference: Points, shielded: Points, thrust_n: Floats) -> Floats:
    """Loss of one block at thrusts; NaN where either does not reach."""
    return interpolated_db(reference, thrust_n) - interpolated_db(shielded, thrust_n)


def insertion_loss(shield: str, reference: Blocks, shielded: Blocks, target_n: float | None = None) -> Loss | None:
    """Loss of one shield, None where no block holds both it and the reference over a common range of thrust."""
    both = [b for b in sorted(reference) if b in shielded and len(reference[b]) >= 2 and len(shielded[b]) >= 2]
    grid = common_thrusts([{b: reference[b] for b in both}, {b: shielded[b] for b in both}])
    if grid.size == 0:
        return None
    rows = {b: loss_db(reference[b], shielded[b], grid) for b in both}
    table = np.stack(list(rows.values()))
    at_target = None
    if target_n is not None:
        values = [float(loss_db(reference[b], shielded[b], np.array([target_n]))[0]) for b in both]
        finite = [v for v in values if math.isfinite(v)]
        at_target = mean_of_blocks(finite) if finite else None
    per_block = {b: float(row.mean()) for b, row in rows.items()}
    return Loss(shield, mean_of_blocks(list(per_block.values())), tuple(grid.tolist()),
                tuple(mean_of_blocks(table[:, k].tolist()) for k in range(grid.size)), at_target, per_block)


@dataclass(frozen=True)
class Difference:
    """How much quieter `one` is than `other`, dB at equal thrust, paired within blocks.

    `answer`: "quieter", "louder", "equal" (the whole interval within 1 dB) or "cannot distinguish".
    """

    one: str
    other: str
    estimate: Estimate
    answer: str
    blocks_needed: int | None

    @property
    def sentence(self) -> str:
        """For people."""
        e = self.estimate
        seen = f"{e.value:+.2f} dB" + ("" if e.low is None or e.high is None else f" ({e.low:+.2f} to {e.high:+.2f})")
        if self.answer == "equal":
            return f"{self.one} and {self.other} are equal within {SAME_DB:g} dB: {seen}"
        if self.answer != "cannot distinguish":
            return f"{self.one} is {self.answer} than {self.other}: {seen}"
        if e.low is None:
            return f"cannot distinguish {self.one} from {self.other} in one block: {seen}; run at least 3 blocks"
        more = f"; about {self.blocks_needed} blocks would decide" if self.blocks_needed else ""
        return f"cannot distinguish {self.one} from {self.other}: {seen}{more}"


def difference(one: str, other: str, one_blocks: Blocks, other_blocks: Blocks) -> Difference | None:
    """Compare two conditions pair by pair; None without a common block and thrust."""
    loss = insertion_loss(one, other_blocks, one_blocks)
    if loss is None:
        return None
    e = loss.overall
    if e.low is not None and e.high is not None and e.low >= -SAME_DB and e.high <= SAME_DB:
        answer = "equal"
    elif e.excludes_zero:
        answer = "quieter" if e.value > 0.0 else "louder"
    else:
        answer = "cannot distinguish"
    needed = None
    if answer == "cannot distinguish" and e.deviation:
        # Decided once the interval lies beside zero, or within what counts as equal, if value and spread stay.
        found = blocks_needed(e.deviation, max(abs(e.value), SAME_DB - abs(e.value)))
        needed = None if found is None else max(found, e.blocks + 1)
    return Difference(one, other, e, answer, needed)
