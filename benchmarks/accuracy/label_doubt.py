"""Wrong labels of the first pass: their number, and how doubtful each of them is.

For every level and kind of body there are random starts, and starts that approach the basin
boundary: the midpoints of a bisection between two starts with different outcomes.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

import dipoletop as dt
from benchmarks import engines
from benchmarks.accuracy import separatrix
from benchmarks.accuracy.label_costs import RTOL, TRUTH, labels, ways
from benchmarks.accuracy.long_runs import merged
from benchmarks.accuracy.separatrix import wrong
from benchmarks.problems import random_bodies
from benchmarks.problems.random_bodies import directions

MAX_STEPS = 4000
BATCH = 65_536  # starts in one call: they are one block, so that its passes can be told apart
PAIRS = 16_384  # starts from which bisections begin, at most
ROUNDS = 20  # of a bisection: the last start is 1e-6 of the first distance from the boundary
SHOWN = 3  # starts of each block whose label only the default has wrong that are kept
TOPS = {
    "tops, any δ": (-0.99, 0.99, 1.0),
    "tops, −½ < δ < 0": (-0.5, 0.0, 1.0),
    "tops, nearly spherical": (-0.05, 0.05, 1.0),
    "tops, slow needles": (0.7532, 0.99, 0.05),
}
"""For each kind of top: bounds of δ, and the largest |ω₀|."""
MANY = {"1": 262_144, "2": 32_768, "3": 32_768, "4": 32_768, "semi": 262_144}
"""Starts at random of each kind of top, by the level."""
OF_BODIES = {"1": 8192, "semi": 8192}
"""The same of the families of bodies."""
Row = dict[str, Any]


class Case(NamedTuple):
    """Tops or bodies, each with a start."""

    equations: Any
    omegas: Float[np.ndarray, "n 3"]

    def some(self, which: Any) -> "Case":
        """Return some of them."""
        part = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf)[which]), self.equations)
        return Case(part, self.omegas[which])

    def labels(self, rtol: float, **way: Any) -> Int[np.ndarray, " n"]:
        """Return outcomes, with the settings `way` of `engines.driven`."""
        return labels(self.equations, self.omegas, MAX_STEPS, rtol, **way)


def tops(level: str, kind: str, n: int, rng: np.random.Generator) -> Case:
    """Return tops of one kind, δ uniform, |ω₀| log-uniform over two decades and a half."""
    low, high, most = TOPS[kind]
    order = random_bodies.LEVELS[level]
    most = most if order in (1, None) else min(most, 0.2)  # above it, the higher orders diverge
    delta = jnp.asarray(rng.uniform(low, high, n))
    size = most * 10 ** rng.uniform(-2.5, 0, n)
    equations = dt.TransverseSemi(delta) if order is None else dt.TransverseReduced(delta, order)
    return Case(equations, size[:, None] * directions(n, rng))


def bodies(level: str, family: str, n: int, number: int) -> Case:
    """Return bodies of one family of `random_bodies`."""
    sample = random_bodies.starts(family, level, n, (1, number))
    trailing = random_bodies.equations(level, sample.inertia, sample.dipole)
    equations = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, -1, 0), trailing)
    return Case(equations, sample.omega)


def judged(case: Case, truth: Int[np.ndarray, " n"] | None = None) -> Row:
    """Count wrong labels of the first pass, of one pass at the tolerance, and of the default.

    `lost` counts labels that are wrong by default but right in one pass.
    """
    if truth is None:
        truth = case.labels(TRUTH, once=True)
    passes: list[engines.Pass] = []
    failing = wrong(case.labels(RTOL, passes=passes), truth)
    once = wrong(case.labels(RTOL, once=True), truth)
    first, *again = passes
    missed = wrong(first.ended.runs.outcome, truth)
    lost = np.flatnonzero(failing & ~once)
    return {
        "starts": len(truth),
        "decided": int(np.sum(truth > 0)),
        "again": sum(done.runs for done in again),
        "wrong_first": int(np.sum(missed)),
        "wrong_once": int(np.sum(once)),
        "wrong": int(np.sum(failing)),
        "lost": len(lost),
        "margin": float(np.max(1 / first.ended.doubt[missed], initial=0.0)),
        "lost_starts": [_shown(case.some([lane]), int(truth[lane])) for lane in lost[:SHOWN]],
    }


def _shown(case: Case, truth: int) -> Row:
    leaves = [np.ravel(leaf).tolist() for leaf in jax.tree.leaves(case.equations)]
    return {"equation": leaves, "omega": case.omegas[0].tolist(), "truth": truth}


def closing_in(
    case: Case, rng: np.random.Generator, rtol: float = TRUTH
) -> Iterator[tuple[Case, Int[np.ndarray, " n"]]]:
    """Yield starts ever nearer to the boundary, with their outcomes at `rtol`, round by round."""
    case = case.some(slice(PAIRS))
    low, n = case.omegas, len(case.omegas)
    high = np.linalg.norm(low, axis=1)[:, None] * directions(n, rng)
    label = case.labels(rtol, once=True)
    other = case._replace(omegas=high).labels(rtol, once=True)
    between = np.flatnonzero((label > 0) & (other > 0) & (label != other))
    case, low, high, label = case.some(between), low[between], high[between], label[between]
    for _ in range(ROUNDS if len(between) else 0):
        middle = case._replace(omegas=(low + high) / 2)
        truth = middle.labels(rtol, once=True)
        yield middle, truth
        same = (truth == label)[:, None]
        low, high = np.where(same, middle.omegas, low), np.where(same, high, middle.omegas)


def compare(small: bool) -> list[Row]:
    """A row for each level and kind of body: starts at random, and those that close in."""
    many = {"1": 4096, "semi": 4096} if small else MANY
    kinds = [(level, kind, n) for level, n in many.items() for kind in TOPS]
    if not small:
        families = random_bodies.FAMILIES[:-1]
        kinds += [(level, kind, n) for level, n in OF_BODIES.items() for kind in families]
    rows = []
    for row_number, (level, kind, n) in enumerate(kinds):
        rng = np.random.default_rng([0, row_number])
        at_random = []
        for number, first in enumerate(range(0, n, BATCH)):
            size = min(BATCH, n - first)
            if kind in TOPS:
                case = tops(level, kind, size, rng)
            else:
                case = bodies(level, kind, size, number)
            at_random.append(judged(case))
        near = [judged(*round_) for round_ in closing_in(case, rng)]
        found = {"random": merged(at_random), "near": merged(near)}
        rows.append({"level": level, "kind": kind} | found)
    return rows


def wall(small: bool) -> Row:
    """Labels of starts on both sides of the separatrix, by one pass and by default."""
    near, rows = separatrix.wall(20 if small else 400), []
    case = Case(dt.TransverseReduced(separatrix.DELTA), near.starts.T)
    for (name, rtol), way in ways(small).items():
        rows.append({"name": name, "rtol": rtol} | near.judged(case.labels(rtol, **way)))
    return near.about() | {"rows": rows}
