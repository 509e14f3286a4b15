"""Who takes part in the benchmark beside dipoletop, and the truth they are held to.

A peer is `run(deltas, omegas, rtol) -> dict`: `labels` (integers of dipoletop.Outcome),
`seconds` on the clock, `processor_seconds` (all cores together; steadier where others work too),
`compile_seconds`, `steps` (lane steps made), `note`. A peer that is not installed is left out,
with a line that says so. float64 must be on in jax before a jax peer runs, and heyoka starts
processes: call from under `if __name__ == "__main__"`.
"""

import importlib
from collections.abc import Callable
from functools import partial
from time import perf_counter, process_time
from typing import Any

import numpy as np
import scipy
from jaxtyping import Float
from scipy.integrate import DOP853

import problem

Peer = Callable[..., dict[str, Any]]


def _follow(delta: float, omega: Float[np.ndarray, "3"], rtol: float) -> tuple[int, int]:
    """Label of one undecided start, and the number of steps made."""
    solver = DOP853(
        lambda t, y: np.array(problem.rate(delta, y)),
        0.0,
        omega,
        np.inf,
        rtol=rtol,
        atol=rtol * np.linalg.norm(omega),
        first_step=0.1,
    )
    label, made = problem.UNDECIDED, 0
    budget = 10 * problem.MAX_STEPS  # the tolerance is smaller than the peers'
    # A step tried too far may overflow; it is then rejected.
    with np.errstate(over="ignore", invalid="ignore"):
        while label == problem.UNDECIDED and made < budget and solver.status == "running":
            solver.step()
            label = int(problem.certificate(delta, solver.y))
            made += 1
    return label, made


def truth(
    deltas: Float[np.ndarray, " n"], omegas: Float[np.ndarray, "n 3"], rtol: float = 1e-12
) -> dict[str, Any]:
    """Labels by scipy's DOP853, one start after another, the certificate after every step."""
    labels = problem.certificate(deltas, omegas.T)
    made = 0
    begin, spent = perf_counter(), process_time()
    for i in np.flatnonzero(labels == problem.UNDECIDED):
        labels[i], steps = _follow(deltas[i], omegas[i], rtol)
        made += steps
    return {
        "labels": labels,
        "seconds": perf_counter() - begin,
        "processor_seconds": process_time() - spent,
        "compile_seconds": 0.0,
        "steps": made,
        "note": f"scipy {scipy.__version__} DOP853, one core",
    }


def available() -> tuple[dict[str, Peer], list[str]]:
    """The peers that can run here by name, and one line for each that cannot."""
    peers: dict[str, Peer] = {}
    missing = []
    try:
        peers["heyoka batch"] = importlib.import_module("peer_heyoka").run
    except ImportError as error:
        missing.append(f"heyoka batch: left out ({error})")
    try:
        diffrax = importlib.import_module("peer_diffrax").run
    except ImportError as error:
        missing.append(f"diffrax: left out ({error})")
    else:
        for way in ("repacked", "chunked", "whole"):
            peers[f"diffrax vmap {way}, tuple"] = partial(diffrax, as_tuple=True, way=way)
            peers[f"diffrax vmap {way}, (3,)"] = partial(diffrax, as_tuple=False, way=way)
    return peers, missing
