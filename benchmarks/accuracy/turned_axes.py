"""Does a prediction depend on the axes in which the body is written? By more than its error?

python -m benchmarks.accuracy.turned_axes --small     a look
python -m benchmarks.accuracy.turned_axes             all: about ten minutes
python -m benchmarks.accuracy.turned_axes --write     the same, kept: results/turned_axes.md
"""

import math
from typing import Any

import numpy as np

import dipoletop as dt
from benchmarks.problems import slow_rotations
from benchmarks.problems.random_bodies import Starts, random_rotations
from benchmarks.reporting import pages
from dipoletop import Outcome

COMPARED = "ratio", "half_time"
REFUSAL = "be so small that the estimated relative error"
Row = dict[str, Any]


def compare(n: int, at_random: int) -> list[Row]:
    """Compare predictions of bodies in their principal axes and in turned axes.

    Args:
        n: number of bodies of each degenerate family.
        at_random: number of random bodies.
    """
    rng = np.random.default_rng([0, 43])
    rows = []
    for family, own in slow_rotations.everywhere(n, at_random).items():
        q = random_rotations(rng, len(own.omega))
        inertia = np.einsum("nij,njk,nlk->nil", q, own.inertia, q)
        vectors = (np.einsum("nij,nj->ni", q, vector) for vector in (own.dipole, own.omega))
        turned = Starts((inertia + inertia.transpose(0, 2, 1)) / 2, *vectors)
        pairs = [list(map(predicted, *sample)) for sample in (own, turned)]
        known = [(a, b) for a, b in zip(*pairs, strict=True) if a and b]
        over = [_difference(a, b) / max(a["error"], b["error"]) for a, b in known]
        each = [one for column in pairs for one in column if one]
        rows.append(
            {
                "family": family,
                "n": len(own.omega),
                "refused": 2 * len(own.omega) - len(each),
                "failed": sum(one["outcome"] == Outcome.FAILED for one in each),
                "empty": sum(math.isnan(one["ratio"]) for one in each),
                "no half time": sum(math.isnan(one["half_time"]) for one in each),
                "other": sum(a["outcome"] != b["outcome"] for a, b in known),
                "error": max(one["error"] for one in each),
                "over": max(over),
            }
        )
    return rows


def predicted(inertia: np.ndarray, dipole: np.ndarray, omega: np.ndarray) -> Row | None:
    """Return some numbers of a prediction; None where it is refused."""
    try:
        found = dt.predict(dt.Body(inertia, dipole), omega)
    except ValueError as refusal:
        if REFUSAL not in str(refusal):
            raise
        return None
    return {name: float(getattr(found, name)) for name in ("outcome", "error", *COMPARED)}


def _difference(one: Row, other: Row) -> float:
    """Return the largest relative difference of two predictions; infinite if one lacks a number."""
    worst = 0.0
    for a, b in ((one[name], other[name]) for name in COMPARED):
        if math.isnan(a) != math.isnan(b):
            return math.inf
        if a != b and not math.isnan(a):
            worst = max(worst, abs(a - b) / max(abs(a), abs(b)))
    return worst


def measured(small: bool) -> Row:
    """All of it."""
    return {"rows": compare(*((4, 40) if small else (400, 10_000)))}


if __name__ == "__main__":
    pages.command("turned_axes", measured)
