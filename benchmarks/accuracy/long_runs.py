"""Labels against long integration that uses no verdict.

Each run is continued, with the same equation, from the state of its verdict until its end is plain
(`Settling.plain`, `compare`). `labels.py` makes the table.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks import engines
from benchmarks.problems.random_bodies import Starts, equations
from dipoletop import Outcome, Verdict

RTOL = 1e-8
ON_LINE, TURNS, WOBBLE = 1e-4, 30.0, 1e-12  # see `Settling`


class Shape(NamedTuple):
    """A body seen from its dipole."""

    axes: Any  # (3, 3, N): n along the dipole; then 2 and 3, the principal axes across it
    unit: Any  # |d|²/J, so that ω = unit Ω is the dimensionless angular velocity; J = n·In
    delta: Any  # 1 − J₃/J if the body is axisymmetric about 3 and n principal, otherwise NaN
    principal: Any  # whether n is a principal axis


def _strength(sample: Starts) -> np.ndarray:
    """Return |d|²."""
    return np.sum(sample.dipole**2, axis=1)


def shapes(sample: Starts) -> Shape:
    """Compute the shapes by NumPy, independently of the library."""
    strength = _strength(sample)
    n = sample.dipole / np.sqrt(strength)[:, None]
    lever = np.einsum("nij,nj->ni", sample.inertia, n)
    moment = np.sum(n * lever, axis=1)
    across = np.eye(3) - n[:, :, None] * n[:, None, :]
    moments, vectors = np.linalg.eigh(across @ sample.inertia @ across)  # the lowest, 0, is n
    same = np.abs(moments / moment[:, None] - 1) < 1e-9
    principal = np.linalg.norm(lever - moment[:, None] * n, axis=1) < 1e-9 * moment
    swap = same[:, 2]  # the second axis is the one whose moment equals the dipole's
    second = np.where(swap[:, None], vectors[:, :, 2], vectors[:, :, 1])
    third = np.where(swap[:, None], vectors[:, :, 1], vectors[:, :, 2])
    delta = 1 - np.where(swap, moments[:, 1], moments[:, 2]) / moment
    delta = np.where(principal & same.any(axis=1), delta, np.nan)
    axes = np.stack([n, second, third], axis=1)
    return Shape(axes, strength / moment, delta, principal)


class Settling(eqx.Module):
    """An equation whose verdict may also be a plain end of the motion.

    RESIDUAL is plain on the line Ω ∥ d: |ω₂| and |ω₃| below ON_LINE·min(1, |ω₁|)·|ω₁|, so small
    that the motion is linear there, and `compare` tests whether the line attracts. (For the
    transverse top the line attracts only where ω₃/ω₁² is of order one, so ω₃ ≪ ω₁ is not enough.)

    STOP is never plain from |Ω| alone: any part of it can be lost before a capture. The other
    conditions depend on the body; for the transverse top they follow from its planar system.
    δ < 0: TURNS·(u + Mω₃²) ≤ 2|δω₃|, precession faster than radiation. Then the averages
    (4.13)–(4.15) hold up to 1/TURNS² and give d ln z = −{(3δ/2)u + δ³ω₃²}/(1−δ) dτ > 0 for
    z = ω₃/u: precession stays faster for ever, and a capture needs z of order one.
    δ > 0: z falls by the same law, as |Ω|^(3δ/(1−δ)), until radiation is faster. From then on the
    motion is one of (φ, z), where the line attracts everything except a cycle round the section
    ω₁ = 0. Motions leave the neighbourhood of that cycle at a rate 2/(2+δ) in σ = ∫u dτ. While |Ω|
    falls by the factor WOBBLE, ∫u dτ ≥ −ln WOBBLE, so a run that has not been captured by then
    never is, except about 1e-8 of the starts near the boundary. δ > ½ ensures that little of the
    fall belongs to precession; below it no run that still moves counts as plain.
    Other bodies: see `compare`.
    """

    equation: Any
    shape: Shape
    rest: Any  # |Ω| below which the fall is far enough, (N,)
    long: Any  # True: the verdict is a plain end; False: the equation's verdict; (N,)

    def __call__(self, t, y, args=None):
        return self.equation(t, y, args)

    def lift(self, omega0):
        return omega0

    def omega(self, y):
        return y

    @property
    def omega_scale(self):
        return engines.omega_scale_of(self.equation)

    def verdict(self, y):
        own = self.equation.verdict(y)._replace(equation=Settling)
        return jax.tree.map(lambda a, b: jnp.where(self.long, a, b), self.plain(y), own)

    def plain(self, y):
        w1, w2, w3 = (jnp.sum(axis * y, axis=0) for axis in self.shape.axes)
        unit, d = self.shape.unit, self.shape.delta
        close = ON_LINE * jnp.minimum(1.0, unit * jnp.abs(w1)) * jnp.abs(w1)
        line = (jnp.maximum(jnp.abs(w2), jnp.abs(w3)) <= close) & (w1 != 0)
        drag = unit * (w1**2 + w2**2 + (1 + d + d**2) * w3**2)
        turns = 2 * jnp.abs(d * w3) >= TURNS * drag
        far = jnp.sqrt(w1**2 + w2**2 + w3**2) <= self.rest
        stop = far & (jnp.isnan(d) | (d > 0.5) | (turns & (d < 0)))
        outcome = jnp.where(line, Outcome.RESIDUAL, jnp.where(stop, Outcome.STOP, 0))
        none = jnp.zeros_like(outcome), jnp.zeros_like(w1)
        return Verdict(outcome, w1, stop, *none, equation=Settling)


@jax.jit
def _verdict(equation, y):
    return equation.verdict(y)


@jax.jit
def _attracts(equation, line):
    """Return whether the line of states w n, shape (3, N), attracts.

    One eigenvalue of the Jacobian is 0. The trace and the sum of the principal minors are the sum
    and the product of the other two. They stay accurate where elements differ by a factor ω², but
    the eigenvalues do not.
    """
    jacobian = jax.vmap(jax.jacfwd(lambda v, e: e(0.0, v)), in_axes=(-1, -1))(line, equation)
    j = jnp.moveaxis(jacobian, 0, -1)
    pairs = ((0, 1), (0, 2), (1, 2))
    minors = sum(j[a, a] * j[b, b] - j[a, b] * j[b, a] for a, b in pairs)
    return (j[0, 0] + j[1, 1] + j[2, 2] < 0) & (minors > 0)


def _roundness(inertia: np.ndarray, y: Any) -> np.ndarray:
    """Return h = 2E/L² of Ω = y, shape (3, N)."""
    momentum = np.einsum("nij,jn->in", inertia, y)
    return np.sum(momentum * y, axis=0) / np.sum(momentum**2, axis=0)


class Comparison(NamedTuple):
    """Labels, and the ends of the long runs; arrays of shape (N,)."""

    outcome: np.ndarray
    stop: np.ndarray  # a `Stop`
    certified: np.ndarray
    omega_inf: np.ndarray
    error: np.ndarray
    final: np.ndarray  # label of the long run; 0: not plain within the budget
    value: np.ndarray  # n·Ω at the end of the long run
    steps: np.ndarray

    @property
    def plain(self) -> np.ndarray:
        """Whether a run has a label and a plain end."""
        return (self.outcome > 0) & (self.final > 0)

    @property
    def wrong(self) -> np.ndarray:
        """Whether the plain end contradicts the label."""
        return self.plain & (self.final != self.outcome)

    def counted(self, number: int, **others: np.ndarray) -> dict[str, Any]:
        """Numbers of runs of each kind, sums of `others`, and the wrong runs of piece `number`."""
        sums = {
            "n": np.ones_like(self.outcome),
            "residual": self.outcome == Outcome.RESIDUAL,
            "undecided": self.outcome == Outcome.UNDECIDED,
            "failed": self.outcome == Outcome.FAILED,
            "plain": self.plain,
            "wrong": self.wrong,
            **others,
        }
        row: dict[str, Any] = {name: int(np.sum(values)) for name, values in sums.items()}
        return row | {"wrong_starts": [[number, int(k)] for k in np.flatnonzero(self.wrong)]}


def merged(pieces: list[dict[str, Any]]) -> dict[str, Any]:
    """One row of several: of floats the largest, of texts the first, all else added."""
    row = dict(pieces[0]) if pieces else {}
    for piece in pieces[1:]:
        for name, value in piece.items():
            if isinstance(value, float):
                row[name] = max(row[name], value)
            elif not isinstance(value, str):
                row[name] = row[name] + value
    return row


def compare(
    level: str,
    sample: Starts,
    fall: float = 30.0,
    *,
    budgets: tuple[int, int] = (20_000, 60_000),
    closed: bool = False,
) -> Comparison:
    """Label the starts, integrate on to a plain end, and label that.

    The budgets are the largest numbers of steps before and after the label.
    """
    equation = equations(level, sample.inertia, sample.dipole, closed=closed)
    shape = jax.tree.map(lambda leaf: jnp.asarray(np.moveaxis(leaf, 0, -1)), shapes(sample))
    y = jnp.asarray(sample.omega.T)
    size, zero = jnp.linalg.norm(y, axis=0), jnp.zeros(y.shape[1])

    own = Settling(equation, shape, zero, zero > 0)
    ends = _run(own, y, RTOL * size, budgets[0])
    label = jax.device_get(_verdict(equation, ends.y))
    final, value = _long_run(equation, shape, sample, ends.y, fall, budgets[1])
    status = np.asarray(ends.status)
    outcome = np.where(status == engines.FINISHED, label.outcome, status)
    return Comparison(
        outcome,
        *(label.stop, label.certified, label.omega_inf, label.error),
        *(final, value),
        np.asarray(ends.steps),
    )


def _long_run(
    equation: Any, shape: Shape, sample: Starts, y: Any, fall: float, budget: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the labels of plain ends, 0 where an end is not plain, and n·Ω there.

    If the dipole is off every principal axis, there is no line for a capture. For bodies other than
    the transverse top, |Ω| fallen by the factor `fall` is a plain STOP in two cases. Either the
    line does not attract at the largest n·Ω that the energy still allows, hence at no smaller one.
    Or h = 2E/L², which the slow flow moves in one direction, rises more slowly in the second half
    (of the fall's logarithm) than in the first: a capture would lie beyond a repeller, which
    motions leave ever faster. Free rotation makes h oscillate by a relative |d|²|Ω|/J, which is
    allowed for.
    """
    # The tolerance is relative to each component: ω₃ falls as ω², so an absolute one fails.
    size, zero = jnp.linalg.norm(y, axis=0), jnp.zeros(y.shape[1])
    h, finished = [_roundness(sample.inertia, y)], np.ones(size.shape, bool)
    for part, steps in ((0.5, budget // 5), (1.0, budget)):
        rest = size * jnp.where(shape.delta > 0, WOBBLE, 1 / fall) ** part
        settling = Settling(equation, shape, rest, zero == 0)
        ends = _run(settling, y, 1e-30 * size, steps)
        y = ends.y
        h.append(_roundness(sample.inertia, y))
        finished &= np.asarray(ends.status) == engines.FINISHED
    end = settling.plain(y)
    speed = jnp.linalg.norm(y, axis=0)
    most = np.sqrt(np.linalg.eigvalsh(sample.inertia)[:, 2] * shape.unit / _strength(sample))
    repels = ~_attracts(equation, (most * speed)[None] * shape.axes[0])
    slack = 2 * np.asarray(shape.unit * speed) * np.sqrt(fall)
    slows = h[2] - h[1] <= np.maximum((h[1] - h[0]) / 2, 0) + slack * h[1]
    stops = ~shape.principal | ~jnp.isnan(shape.delta) | repels | slows
    holds = _attracts(equation, end.omega_inf[None] * shape.axes[0])
    sound = jnp.where(end.outcome == Outcome.STOP, stops, holds) & finished
    return np.asarray(jnp.where(sound, end.outcome, 0)), np.asarray(end.omega_inf)


def _run(equation: Any, y: Any, atol: Any, max_steps: int) -> engines.EndStates:
    """Integrate until a verdict is reached, for at most `max_steps` steps."""
    bounds = engines.limits(RTOL, atol, max_steps)
    return engines.integrate_by_the_fastest(equation, y, bounds, until="outcome")
