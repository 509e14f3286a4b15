"""Costs of labels of the mixed basin, and numbers of wrong ones, at every tolerance."""

from functools import partial
from typing import Any

import diffrax
import jax.numpy as jnp
import numpy as np

import dipoletop as dt
from benchmarks import engines
from benchmarks.accuracy.separatrix import counted
from benchmarks.peers.available import available
from benchmarks.problems import mixed_basin
from benchmarks.reporting import measure
from benchmarks.reporting.views import DEFAULT, HEYOKA

RTOL = 1e-8  # the default tolerance
TRUTH = 1e-11  # tolerance of the reference labels
METHODS = {"Dopri8": diffrax.Dopri8(), "Tsit5": diffrax.Tsit5()}
Row = dict[str, Any]


def ways(small: bool) -> dict[tuple[str, float], Row]:
    """The default, and one pass of each method at each tolerance, as `engines.driven` has them."""
    tolerances = (1e-3, 1e-6) if small else [10.0**-k for k in range(2, 9)]
    every: dict[tuple[str, float], Row] = {(DEFAULT, RTOL): {}}
    for name, method in METHODS.items():
        every |= {(name, rtol): {"method": method, "once": True} for rtol in tolerances}
    return every


def labels(equations: Any, omegas: Any, max_steps: int, rtol: float, **way: Any) -> np.ndarray:
    """Outcomes, with the settings `way` of `engines.driven`."""
    settings: Any = {"rtol": rtol, "max_steps": max_steps, "value": False, "slow_flow": False}
    with engines.driven(**way):
        return np.asarray(dt.classify_many(equations, omegas, **settings).outcome)


def compare(small: bool) -> Row:
    """One row for each method and tolerance."""
    n = 2048 if small else 262_144
    deltas, omegas = mixed_basin.sample(n)
    equations, starts = dt.TransverseReduced(jnp.asarray(deltas)), jnp.asarray(omegas)

    labelled = partial(labels, equations, starts, mixed_basin.MAX_STEPS)

    def ours(rtol: float, way: Row) -> Row:
        """A record as the peers give it."""
        found, clocks = measure.timed(labelled, rtol, **way)
        return clocks | {"labels": found}

    truth = labelled(TRUTH, once=True)
    cases: Row = {key: partial(ours, key[1], way) for key, way in ways(small).items()}
    measure.interleaved(cases, 1)  # everybody is measured warm; heyoka sees to it itself
    peers, missing = available()
    if HEYOKA in peers:
        for rtol in (1e-4,) if small else [10.0**-k for k in range(2, 10)]:
            cases[HEYOKA, rtol] = partial(peers[HEYOKA], deltas, omegas, rtol)
    rows = []
    for (name, rtol), runs in measure.interleaved(cases, 1 if small else 3).items():
        made = runs[0].get("steps")
        if made is None:  # the steps of all passes
            passes: list[engines.Pass] = []
            labelled(rtol, passes=passes, **ways(small)[name, rtol])
            made = sum(int(done.ended.runs.steps.sum()) for done in passes)
        row = {"name": name, "rtol": rtol, "starts": n, "steps": made / n}
        rows.append(row | measure.summary(runs) | counted(runs[0]["labels"], truth))
    about = {"truth": TRUTH, "undecided": int(np.sum(truth <= 0)), "missing": missing}
    return {"starts": n, **about, "rows": rows}
