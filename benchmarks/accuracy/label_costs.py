"""Costs of labels of the mixed basin, and numbers of wrong ones, at every tolerance."""

import importlib
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import diffrax
import jax.numpy as jnp
import numpy as np

import dipoletop as dt
from benchmarks import engines
from benchmarks.problems import mixed_basin
from benchmarks.reporting import measure
from benchmarks.reporting.label_precision import DEFAULT, HEYOKA

RTOL = 1e-8  # the default tolerance
TRUTH = 1e-11  # tolerance of the reference labels
METHODS = {"Dopri8": diffrax.Dopri8(), "Tsit5": diffrax.Tsit5()}
Row = dict[str, Any]


class Sizes(NamedTuple):
    """Sizes of the measurement."""

    starts: int = 262_144
    repeats: int = 3
    tolerances: tuple[float, ...] = tuple(10.0**-k for k in range(2, 9))
    heyoka: tuple[float, ...] = tuple(10.0**-k for k in range(2, 10))


FEW = Sizes(starts=2048, repeats=1, tolerances=(1e-3, 1e-6), heyoka=(1e-4,))


class Problem:
    """The labels of the mixed basin by `classify_many`, computed in several ways."""

    def __init__(self, n: int) -> None:
        self.deltas, self.omegas = mixed_basin.sample(n)
        self.equations = dt.TransverseReduced(jnp.asarray(self.deltas))
        self.starts = jnp.asarray(self.omegas)

    def labelled(self, rtol: float, **way: Any) -> dt.Classification:
        """Return the classification, with the settings `way` of `engines.driven`."""
        settings: Any = {"rtol": rtol, "max_steps": mixed_basin.MAX_STEPS, "value": False}
        with engines.driven(**way):
            return dt.classify_many(self.equations, self.starts, slow_flow=False, **settings)

    def ours(self, rtol: float, **way: Any) -> Row:
        """Return a record in the form of a peer's."""
        runs, clocks = measure.timed(lambda: self.labelled(rtol, **way))
        return clocks | {"labels": runs.outcome}

    def steps(self, rtol: float, **way: Any) -> int:
        """Return the steps of all passes."""
        passes: list[engines.Pass] = []
        self.labelled(rtol, passes=passes, **way)
        return sum(int(done.ended.runs.steps.sum()) for done in passes)


def compare(sizes: Sizes) -> Row:
    """Return a row for each method and tolerance."""
    problem = Problem(sizes.starts)
    truth = np.asarray(problem.labelled(TRUTH, once=True).outcome)
    ways: dict[Any, Row] = {(DEFAULT, RTOL): {}}
    for name, method in METHODS.items():
        ways |= {(name, rtol): {"method": method, "once": True} for rtol in sizes.tolerances}
    cases: dict[Any, Callable[[], Row]] = {
        key: partial(problem.ours, key[1], **way) for key, way in ways.items()
    }
    measure.interleaved(cases, 1)  # all are measured warm; heyoka warms itself up
    missing = []
    try:
        heyoka = importlib.import_module("benchmarks.peers.with_heyoka").run
    except ImportError as error:
        missing.append(f"{HEYOKA}: left out ({error})")
    else:
        for rtol in sizes.heyoka:
            cases[HEYOKA, rtol] = partial(heyoka, problem.deltas, problem.omegas, rtol)
    records = measure.interleaved(cases, sizes.repeats)
    rows = []
    for (name, rtol), runs in records.items():
        made = runs[0].get("steps")
        made = problem.steps(rtol, **ways[name, rtol]) if made is None else made
        row = {"name": name, "rtol": rtol, "starts": sizes.starts, "steps": made / sizes.starts}
        rows.append(row | measure.summary(runs) | counted(runs[0]["labels"], truth))
    about = {"truth": TRUTH, "undecided": int(np.sum(truth <= 0)), "missing": missing}
    return {"starts": sizes.starts, **about, "rows": rows}


def counted(labels: np.ndarray, truth: np.ndarray) -> dict[str, int]:
    """Return the numbers of wrong labels, where both decide, and of undecided ones."""
    wrong = (labels > 0) & (truth > 0) & (labels != truth)
    return {"wrong": int(np.sum(wrong)), "undecided": int(np.sum(labels <= 0))}
