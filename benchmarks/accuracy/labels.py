"""Are the labels right? Every verdict against long integration without verdicts (`long_runs.py`).

python -m benchmarks.accuracy.labels --small     a look
python -m benchmarks.accuracy.labels             all, a process for each core; hours
python -m benchmarks.accuracy.labels --write     the same, kept: results/labels.md
"""

import concurrent.futures
import itertools
import multiprocessing
from typing import Any

import jax
import numpy as np

from benchmarks.accuracy.long_runs import RTOL, compare, merged
from benchmarks.problems.random_bodies import FAMILIES, LEVELS, starts
from benchmarks.reporting import measure, pages
from dipoletop import Outcome, Stop

MANY = {"1": 4000, "semi": 4000, "2": 1000, "3": 500, "4": 250}  # starts of a general family
PIECE = {"1": 2000, "semi": 2000, "2": 1000, "3": 1000, "4": 1000}  # … computed together
COSTLY = ("4", "3", "2", "semi", "1")
Row = dict[str, Any]


def counted(level: str, family: str, n: int, number: int) -> Row:
    """Run a piece: over the pieces of a row integers are added, of floats the largest is kept."""
    jax.config.update("jax_enable_x64", True)
    c = compare(level, starts(family, level, n, (0, number)), closed=family == "closed")
    decided, stop = c.outcome > 0, c.outcome == Outcome.STOP
    both = c.plain & ~c.wrong & ~stop
    both &= np.isfinite(c.omega_inf)  # at order 1 many labels come without
    off = np.where(both, np.abs(c.omega_inf / np.where(both, c.value, 1) - 1), 0)
    over = off / np.maximum(c.error, 10 * RTOL)
    rotating, wobbling = stop & (c.stop == Stop.ROTATING), stop & (c.stop == Stop.WOBBLING)
    row = c.counted(
        number,
        stop_rotating=rotating,
        stop_wobbling=wobbling,
        stop_other=stop & ~rotating & ~wobbling,
        certified=decided & c.certified,
        steps=c.steps,
    )
    for name, part in (("certified", c.certified), ("tested", ~c.certified)):
        row[f"over_{name}"] = float(np.where(part, over, 0).max())
        row[f"beyond_{name}"] = float(np.where(part & (over > 1), off, 0).max())
    return {"level": level, "family": family} | row


def measured(small: bool) -> Row:
    """All the pieces, those that take longest first; a row for each level and family."""
    pieces = []
    for level, family in [("1", "closed")] if small else itertools.product(LEVELS, FAMILIES):
        closed = family == "closed"
        total = 300 if small else 20_000 if closed else MANY[level]
        size = 5000 if closed else PIECE[level]
        for number, first in enumerate(range(0, total, size)):
            pieces.append((level, family, min(size, total - first), number))
    pieces.sort(key=lambda p: (p[1] == "closed", COSTLY.index(p[0]), p[3]))
    fresh, rows = multiprocessing.get_context("spawn"), {}
    with concurrent.futures.ProcessPoolExecutor(measure.cores(), mp_context=fresh) as pool:
        for found in pool.map(counted, *zip(*pieces, strict=True)):
            rows.setdefault((found["level"], found["family"]), []).append(found)
    wanted = [key for key in itertools.product(LEVELS, FAMILIES) if key in rows]
    run = {"command": measure.command(), **measure.machine()}
    return {"runs": [run], "rows": [merged(rows[key]) for key in wanted]}


if __name__ == "__main__":
    pages.command("labels", measured)
