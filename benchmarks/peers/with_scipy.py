"""scipy's DOP853, one start after another: the reference labels."""

from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.integrate import DOP853

from benchmarks.problems import mixed_basin
from benchmarks.reporting import measure


def _label(delta: float, omega: Float[np.ndarray, "3"], rtol: float) -> tuple[int, int]:
    """Return the label of one undecided start, and its number of steps."""
    solver = DOP853(
        lambda t, y: np.array(mixed_basin.rate(delta, y)),
        0.0,
        omega,
        np.inf,
        rtol=rtol,
        atol=rtol * np.linalg.norm(omega),
        first_step=0.1,
    )
    label, made = mixed_basin.UNDECIDED, 0
    budget = 10 * mixed_basin.MAX_STEPS  # the tolerance is smaller than the peers'
    # A trial step that is too long may overflow; it is then rejected.
    with np.errstate(over="ignore", invalid="ignore"):
        while label == mixed_basin.UNDECIDED and made < budget and solver.status == "running":
            solver.step()
            label = int(mixed_basin.certificate(delta, solver.y))
            made += 1
    return label, made


def run(
    deltas: Float[np.ndarray, " n"], omegas: Float[np.ndarray, "n 3"], rtol: float
) -> dict[str, Any]:
    """Label all starts, testing the certificate after every step."""
    labels = mixed_basin.certificate(deltas, omegas.T)
    live = np.flatnonzero(labels == mixed_basin.UNDECIDED)
    found, clocks = measure.timed(lambda: [_label(deltas[i], omegas[i], rtol) for i in live])
    labels[live] = [label for label, _ in found]
    made = sum(steps for _, steps in found)
    return clocks | {"labels": labels, "compile_seconds": 0.0, "steps": made}
