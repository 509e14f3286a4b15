"""Are the labels right? Verdicts of general bodies against long continued integration.

Each run goes on from the state in which the verdict fell, with the same equation and no verdict,
until its end is plain to see: on the line Ω ∥ d to one part in a million, where the eigenvalues of
the Jacobian are looked at, or |Ω| fallen to a small part of what it was. A body with its dipole off
every principal axis, or one that is bound to stop, must do the second, a residual one the first.

    python benchmarks/labels.py --n 2000 --levels 1 semi --families asymmetric generic
"""

import argparse
import functools
import time
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from dipoletop import lanes
from dipoletop._types import Outcome, Verdict
from dipoletop.bodies import Body
from dipoletop.equations.rigid import Reduced, SemiReduced

LEVELS = {"1": 1, "2": 2, "3": 3, "4": 4, "semi": None}
FAMILIES = ("transverse", "near", "asymmetric", "generic", "oblate")
RTOL = 1e-8
ON_LINE = 1e-6  # |x| ≤ this times |w|: on the line


class Starts(NamedTuple):
    """One body and one angular velocity for each run."""

    inertia: np.ndarray  # (N, 3, 3)
    dipole: np.ndarray  # (N, 3)
    omega: np.ndarray  # (N, 3)


class Settling(eqx.Module):
    """The same equation, which may also take for its verdict an end that is plain to see."""

    equation: Any
    axis: Any  # n, (3, N)
    rest: Any  # |Ω| that counts as stopped, (N,); 0 asks for the verdict of the equation

    def __call__(self, t, y, args=None):
        return self.equation(t, y, args)

    def lift(self, omega0):
        return omega0

    def omega(self, y):
        return y

    def verdict(self, y):
        own = self.equation.verdict(y)
        return jax.tree.map(lambda a, b: jnp.where(self.rest > 0, a, b), self.plain(y), own)

    def plain(self, y):
        w = jnp.sum(self.axis * y, axis=0)
        across = y - w[None] * self.axis
        line = jnp.sum(across**2, axis=0) <= (ON_LINE * w) ** 2
        slow = jnp.sum(y**2, axis=0) <= self.rest**2
        outcome = jnp.where(slow, Outcome.STOP, jnp.where(line, Outcome.RESIDUAL, 0))
        return Verdict(outcome, w, slow, jnp.zeros_like(outcome), jnp.zeros_like(w))


@functools.cache
def _builder(order: int | None):
    def one(inertia, dipole):
        body = Body(inertia, dipole)
        return SemiReduced(body) if order is None else Reduced(body, order)

    return jax.jit(jax.vmap(one, out_axes=-1))


def equations(level: str, inertia, dipole):
    """A batch of equations with trailing lanes."""
    return _builder(LEVELS[level])(jnp.asarray(inertia), jnp.asarray(dipole))


def moments(rng, n: int) -> np.ndarray:
    """Principal moments of real bodies, uniform in the triangle J₁+J₂+J₃ = 2; shape (n, 3)."""
    return 1 - rng.dirichlet(np.ones(3), n)  # from the moments of second order ⟨x_i²⟩ > 0


def random_rotations(rng, n: int) -> np.ndarray:
    """Rotation matrices (n, 3, 3)."""
    q, r = np.linalg.qr(rng.normal(size=(n, 3, 3)))
    q = q * np.sign(np.diagonal(r, axis1=1, axis2=2))[:, None, :]
    q[:, :, 0] *= np.linalg.det(q)[:, None]
    return q


def starts(family: str, level: str, n: int, seed: int = 0) -> Starts:
    """Random bodies of one family with isotropic starts.

    Amplitudes |d|²|Ω|√tr(I⁻²) are log-uniform in 0.01 … 1, but end at 0.2 for the orders from 2 on,
    which diverge beyond.
    """
    rng = np.random.default_rng([seed, FAMILIES.index(family)])
    axis = np.eye(3)[rng.integers(0, 3, n)]
    j = moments(rng, n)
    turn = random_rotations(rng, n)
    if family == "transverse":
        axis = np.eye(3)[np.zeros(n, int)]
        j = np.stack([np.ones(n), np.ones(n), 1 - rng.uniform(-1, 0.98, n)], axis=1)
    elif family == "near":
        delta, split = rng.uniform(-0.98, 0.98, n), 10 ** rng.uniform(-6, -1, n)
        axis = np.eye(3)[np.zeros(n, int)]
        j = np.stack([np.ones(n), 1 + rng.choice([-1, 1], n) * split, 1 - delta], axis=1)
        j[:, 2] = np.clip(j[:, 2], np.abs(j[:, 1] - 1) * 1.01, (1 + j[:, 1]) * 0.999)
    elif family == "oblate":  # dipole on the smallest moment, both outcomes
        axis = np.eye(3)[np.zeros(n, int)]
        low = rng.uniform(0.41, 0.59, n)
        least = np.maximum(low, 1 - low) + 0.001
        j = np.stack([low, least + rng.uniform(0, 1, n) * (0.605 - least), np.ones(n)], axis=1)
    elif family == "generic":
        axis = rng.normal(size=(n, 3))
    axis = axis * (10 ** rng.uniform(-0.3, 0.3, n) / np.linalg.norm(axis, axis=1))[:, None]
    reach = np.sum(axis**2, axis=1) * np.sqrt(np.sum(1 / j**2, axis=1))
    top = 1.0 if level in ("1", "semi") else 0.2
    speed = 10 ** rng.uniform(-2, np.log10(top), n) / reach
    omega = rng.normal(size=(n, 3))
    omega *= (speed / np.linalg.norm(omega, axis=1))[:, None]
    inertia = np.einsum("nij,nj,nkj->nik", turn, j, turn)
    inertia = (inertia + inertia.transpose(0, 2, 1)) / 2
    dipole, omega = np.einsum("nij,knj->kni", turn, np.stack([axis, omega]))
    return Starts(inertia, dipole, omega)


def limits(y, max_steps: int) -> lanes.Limits:
    size = jnp.linalg.norm(y, axis=0)
    return lanes.Limits(
        jnp.asarray(RTOL), RTOL * size, jnp.full(y.shape[1], jnp.inf), jnp.asarray(max_steps)
    )


@jax.jit
def _judge(equation, y):
    return equation.verdict(y)


@jax.jit
def _jacobians(equation, axis, w):
    """Jacobian of the equation at w n, shape (N, 3, 3)."""
    return jax.vmap(jax.jacfwd(lambda v, e: e(0.0, v)), in_axes=(-1, -1))(w[None] * axis, equation)


class Comparison(NamedTuple):
    """What came out; arrays of shape (N,) but for the times."""

    outcome: np.ndarray
    omega_inf: np.ndarray
    error: np.ndarray
    final: np.ndarray  # label of the long run; 0: not plain within the budget
    value: np.ndarray  # n·Ω at the end of the long run
    steps: np.ndarray
    seconds: tuple[float, float]


def compare(
    level: str,
    sample: Starts,
    fall: float = 30.0,
    *,
    budgets: tuple[int, int] = (20_000, 60_000),
    solver: diffrax.AbstractERK | None = None,
) -> Comparison:
    """Label the starts, go on to an end that is plain, and look again."""
    equation = equations(level, sample.inertia, sample.dipole)
    axis = jnp.asarray((sample.dipole / np.linalg.norm(sample.dipole, axis=1)[:, None]).T)
    y = jnp.asarray(sample.omega.T)
    run = functools.partial(lanes.integrate, solver=solver, until="outcome")

    begin = time.perf_counter()
    ends = run(Settling(equation, axis, jnp.zeros(y.shape[1])), y, limits(y, budgets[0]))
    found = jax.device_get(_judge(equation, ends.y))
    middle = time.perf_counter()
    settling = Settling(equation, axis, jnp.linalg.norm(ends.y, axis=0) / fall)
    later = run(settling, ends.y, limits(ends.y, budgets[1]))
    judged = settling.plain(later.y)
    jacobians = np.nan_to_num(_jacobians(equation, axis, judged.omega_inf))
    # One eigenvalue is 0, along the line; the other two must have negative real parts.
    rates = np.sort(np.linalg.eigvals(jacobians).real, axis=1)
    attracts = (rates[:, 1] < 0) & (rates[:, 2] <= 1e-6 * np.abs(rates[:, 0]))
    final = np.asarray(jnp.where(later.status == 1, judged.outcome, 0))
    final = np.where((final == Outcome.RESIDUAL) & ~attracts, Outcome.UNDECIDED, final)
    outcome = np.where(np.asarray(ends.status) == 1, found.outcome, np.asarray(ends.status))
    return Comparison(
        outcome,
        found.omega_inf,
        found.error,
        final,
        np.asarray(judged.omega_inf),
        np.asarray(ends.steps),
        (middle - begin, time.perf_counter() - middle),
    )


def row(level: str, family: str, c: Comparison) -> str:
    decided = c.outcome > 0
    plain = decided & (c.final > 0)
    wrong = plain & (c.final != c.outcome)
    both = plain & (c.outcome == Outcome.RESIDUAL) & ~wrong
    off = np.abs(c.omega_inf / np.where(both, c.value, 1) - 1)[both]
    over = off / np.maximum(c.error[both], 10 * RTOL)
    return (
        f"{level:>5} {family:>11} {c.outcome.size:6d} {(c.outcome == 1).sum():6d} "
        f"{(c.outcome == 2).sum():6d} {(c.outcome == 0).sum():6d} {(c.outcome < 0).sum():6d} "
        f"{plain.sum():6d} {wrong.sum():6d} {off.max(initial=0):9.1e} {over.max(initial=0):9.1e} "
        f"{c.steps.mean():8.0f} {c.seconds[0]:6.1f} {c.seconds[1]:6.1f}"
    )


HEAD = (
    "level      family      N    RES   STOP  UNDEC FAILED  plain  WRONG   |Δω∞|/ω∞  over est.   "
    "steps   s(1)   s(2)"
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--n", type=int, default=1000)
    parser.add_argument("--levels", nargs="+", choices=LEVELS, default=list(LEVELS))
    parser.add_argument("--families", nargs="+", choices=FAMILIES, default=list(FAMILIES))
    parser.add_argument("--fall", type=float, default=30.0, help="|Ω| falls so far: stopped")
    parser.add_argument("--budget", type=int, nargs=2, default=(20_000, 60_000))
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    print(HEAD)
    for level in args.levels:
        for family in args.families:
            sample = starts(family, level, args.n, args.seed)
            # XLA needs minutes for twelve stages of the orders from 3 on.
            solver = diffrax.Tsit5() if level in ("3", "4") else diffrax.Dopri8()
            budgets = tuple(args.budget)
            result = compare(level, sample, args.fall, budgets=budgets, solver=solver)
            print(row(level, family, result), flush=True)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main()
