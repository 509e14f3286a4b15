"""Are the labels right? Every verdict against long integration that knows no verdict.

Each run goes on from the state in which the verdict fell, with the same equation, until its end is
plain to see (`Settling.plain`, `compare`). The families are `closed`, the axisymmetric top with a
transverse dipole in its own closed forms, and general bodies. `bench_labels.py` makes the table.
"""

import functools
import time
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from dipoletop._base.types import Outcome, Verdict
from dipoletop._engines.interface import EndStates, Limits, Unsupported
from dipoletop._engines.jax_engine import JaxEngine
from dipoletop._engines.native_engine import NativeEngine
from dipoletop.bodies import Body
from dipoletop.equations._common import scales_of
from dipoletop.equations.rigid import Reduced, SemiReduced
from dipoletop.equations.transverse import TransverseReduced, TransverseSemi

LEVELS = {"1": 1, "2": 2, "3": 3, "4": 4, "semi": None}
FAMILIES = ("transverse", "near", "asymmetric", "generic", "oblate", "closed")
RTOL = 1e-8
# When is an end plain? See `Settling`.
ON_LINE, TURNS, WOBBLE = 1e-4, 30.0, 1e-12


class Starts(NamedTuple):
    """One body and one angular velocity for each run."""

    inertia: np.ndarray  # (N, 3, 3)
    dipole: np.ndarray  # (N, 3)
    omega: np.ndarray  # (N, 3)


class Shape(NamedTuple):
    """A body seen from its dipole."""

    axes: Any  # (3, 3, N): n along the dipole; then across it 2 and 3, principal there
    unit: Any  # |d|²/J, so that ω = unit Ω is the dimensionless angular velocity; J = n·In
    delta: Any  # 1 − J₃/J if the body is axisymmetric about 3 and n principal, otherwise NaN
    principal: Any  # whether n is a principal axis


def _strength(sample: Starts) -> np.ndarray:
    """|d|²."""
    return np.sum(sample.dipole**2, axis=1)


def shapes(sample: Starts) -> Shape:
    """By numpy, not by what the library does."""
    strength = _strength(sample)
    n = sample.dipole / np.sqrt(strength)[:, None]
    lever = np.einsum("nij,nj->ni", sample.inertia, n)
    moment = np.sum(n * lever, axis=1)
    across = np.eye(3) - n[:, :, None] * n[:, None, :]
    moments, vectors = np.linalg.eigh(across @ sample.inertia @ across)  # the lowest, 0, is n
    same = np.abs(moments / moment[:, None] - 1) < 1e-9
    principal = np.linalg.norm(lever - moment[:, None] * n, axis=1) < 1e-9 * moment
    swap = same[:, 2]  # the second axis is the one with the moment of the dipole's
    second = np.where(swap[:, None], vectors[:, :, 2], vectors[:, :, 1])
    third = np.where(swap[:, None], vectors[:, :, 1], vectors[:, :, 2])
    delta = 1 - np.where(swap, moments[:, 1], moments[:, 2]) / moment
    delta = np.where(principal & same.any(axis=1), delta, np.nan)
    axes = np.stack([n, second, third], axis=1)
    return Shape(axes, strength / moment, delta, principal)


class Settling(eqx.Module):
    """The same equation, which may also take for its verdict an end that is plain to see.

    RESIDUAL is plain on the line Ω ∥ d: |ω₂| and |ω₃| below ON_LINE·min(1, |ω₁|)·|ω₁|, so small
    that the motion is linear there, whose coefficients `compare` looks at. (For the transverse top
    the line attracts only where ω₃/ω₁² is of order one, so ω₃ ≪ ω₁ would not do.)

    STOP is never plain from |Ω| alone: any part of it can be lost before a capture. What else is
    asked depends on the body, and for the transverse top follows from its planar system.
    δ < 0: TURNS·(u + Mω₃²) ≤ 2|δω₃|, precession faster than radiation. Then the averages
    (4.13)–(4.15) hold but for 1/TURNS² and say d ln z = −{(3δ/2)u + δ³ω₃²}/(1−δ) dτ > 0 for
    z = ω₃/u: precession wins for ever, and a capture needs z of order one.
    δ > 0: z falls by the same law, as |Ω|^(3δ/(1−δ)), until radiation wins, and then the motion is
    that of (φ, z), where the line attracts all but a cycle round the section ω₁ = 0. What leaves
    that cycle's basin does so at a rate 2/(2+δ) in σ = ∫u dτ. While |Ω| falls to a part WOBBLE,
    ∫u dτ ≥ −ln WOBBLE, so what has not been captured by then is held but for a part of about
    1e-8 of starts near the edge. δ > ½ makes sure that little of the fall belongs to precession;
    below it no run that still moves counts as plain.
    Other bodies: see `compare`.
    """

    equation: Any
    shape: Shape
    rest: Any  # |Ω| that counts as fallen far enough, (N,)
    long: Any  # whether to judge by what is plain, (N,); otherwise by the verdict of the equation

    def __call__(self, t, y, args=None):
        return self.equation(t, y, args)

    def lift(self, omega0):
        return omega0

    def omega(self, y):
        return y

    @property
    def scales(self):
        return scales_of(self.equation)

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


@functools.cache
def _builder(order: int | None):
    def one(inertia, dipole):
        body = Body(inertia, dipole)
        return SemiReduced(body) if order is None else Reduced(body, order)

    return jax.jit(jax.vmap(one, out_axes=-1))


def equations(level: str, inertia, dipole, *, closed: bool = False):
    """A batch of equations, trailing lanes; `closed`: diag(1, 1, 1 − δ), dipole (1, 0, 0)."""
    if not closed:
        return _builder(LEVELS[level])(jnp.asarray(inertia), jnp.asarray(dipole))
    delta, order = jnp.asarray(1 - inertia[:, 2, 2]), LEVELS[level]
    return TransverseSemi(delta) if order is None else TransverseReduced(delta, order)


def moments(rng, n: int) -> np.ndarray:
    """Principal moments of real bodies, uniform in the triangle J₁+J₂+J₃ = 2; shape (n, 3)."""
    return 1 - rng.dirichlet(np.ones(3), n)  # from the moments of second order ⟨x_i²⟩ > 0


def random_rotations(rng, n: int) -> np.ndarray:
    """Rotation matrices (n, 3, 3)."""
    q, r = np.linalg.qr(rng.normal(size=(n, 3, 3)))
    q = q * np.sign(np.diagonal(r, axis1=1, axis2=2))[:, None, :]
    q[:, :, 0] *= np.linalg.det(q)[:, None]
    return q


def starts(family: str, level: str, n: int, seed: int | tuple[int, int] = 0) -> Starts:
    """Random bodies of one family with isotropic starts.

    Amplitudes |d|²|Ω|√tr(I⁻²) are log-uniform in 0.01 … 1, but end at 0.2 for the orders from 2 on,
    which diverge beyond.
    """
    rng = np.random.default_rng([*np.atleast_1d(seed), FAMILIES.index(family)])
    axis = np.eye(3)[rng.integers(0, 3, n)]
    j = moments(rng, n)
    turn = random_rotations(rng, n)
    if family in ("closed", "transverse"):
        axis = np.eye(3)[np.zeros(n, int)]
        j = np.stack([np.ones(n), np.ones(n), 1 - rng.uniform(-0.98, 0.98, n)], axis=1)
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
    if family == "closed":
        turn = np.broadcast_to(np.eye(3), turn.shape)
    else:
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


@jax.jit
def _judge(equation, y):
    return equation.verdict(y)


@jax.jit
def _attracts(equation, line):
    """Whether the line attracts at w n, shape (3, N): by the Jacobian, one of whose rates is 0.

    Trace and sum of minors, the sum and the product of the other two rates, do not suffer from
    an element that is smaller than another by ω², as eigenvalues would.
    """
    jacobian = jax.vmap(jax.jacfwd(lambda v, e: e(0.0, v)), in_axes=(-1, -1))(line, equation)
    j = jnp.moveaxis(jacobian, 0, -1)
    pairs = ((0, 1), (0, 2), (1, 2))
    minors = sum(j[a, a] * j[b, b] - j[a, b] * j[b, a] for a, b in pairs)
    return (j[0, 0] + j[1, 1] + j[2, 2] < 0) & (minors > 0)


def _roundness(inertia: np.ndarray, y: Any) -> np.ndarray:
    """h = 2E/L² of Ω = y, shape (3, N)."""
    momentum = np.einsum("nij,jn->in", inertia, y)
    return np.sum(momentum * y, axis=0) / np.sum(momentum**2, axis=0)


class Comparison(NamedTuple):
    """What came out; arrays of shape (N,) but for the times."""

    outcome: np.ndarray
    stop: np.ndarray  # in which way, a `Stop`
    certified: np.ndarray
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
    closed: bool = False,
) -> Comparison:
    """Label the starts, go on to an end that is plain, and look again.

    Where the dipole is off every principal axis there is no line to be captured by. For other
    bodies than the transverse top, |Ω| fallen by `fall` is a plain STOP if the line attracts
    nothing at the largest n·Ω that the energy still allows, hence at no smaller one; or if the
    slow flow, which moves h = 2E/L² one way along a line, rises more slowly in the second half
    (of the fall's logarithm) than in the first: a repeller, behind which the capture would be,
    is left faster and faster. Free rotation waves h by a part |d|²|Ω|/J, which is let pass.
    """
    equation = equations(level, sample.inertia, sample.dipole, closed=closed)
    shape = jax.tree.map(lambda leaf: jnp.asarray(np.moveaxis(leaf, 0, -1)), shapes(sample))
    y = jnp.asarray(sample.omega.T)
    size, none = jnp.linalg.norm(y, axis=0), jnp.zeros(y.shape[1])

    begin = time.perf_counter()
    ends = _run(Settling(equation, shape, none, none > 0), y, limits(RTOL * size, budgets[0]))
    found = jax.device_get(_judge(equation, ends.y))
    middle = time.perf_counter()
    # From here on every component to its own size: ω₃ falls as ω², so nothing else would do.
    size = jnp.linalg.norm(ends.y, axis=0)
    settling, at, h = None, ends, [_roundness(sample.inertia, ends.y)]
    finished = np.ones(size.shape, bool)
    for part, steps in ((0.5, budgets[1] // 5), (1.0, budgets[1])):
        rest = size * jnp.where(shape.delta > 0, WOBBLE, 1 / fall) ** part
        settling = Settling(equation, shape, rest, none == 0)
        at = _run(settling, at.y, limits(1e-30 * size, steps))
        h.append(_roundness(sample.inertia, at.y))
        finished &= np.asarray(at.status) == 1
    judged = settling.plain(at.y)
    speed = jnp.linalg.norm(at.y, axis=0)
    most = np.sqrt(np.linalg.eigvalsh(sample.inertia)[:, 2] * shape.unit / _strength(sample))
    repels = ~_attracts(equation, (most * speed)[None] * shape.axes[0])
    slack = 2 * np.asarray(shape.unit * speed) * np.sqrt(fall)
    slows = h[2] - h[1] <= np.maximum((h[1] - h[0]) / 2, 0) + slack * h[1]
    stops = ~shape.principal | ~jnp.isnan(shape.delta) | repels | slows
    holds = _attracts(equation, judged.omega_inf[None] * shape.axes[0])
    sound = jnp.where(judged.outcome == Outcome.STOP, stops, holds) & finished
    outcome = np.where(np.asarray(ends.status) == 1, found.outcome, np.asarray(ends.status))
    return Comparison(
        outcome,
        *(found.stop, found.certified, found.omega_inf, found.error),
        np.asarray(jnp.where(sound, judged.outcome, 0)),
        np.asarray(judged.omega_inf),
        np.asarray(ends.steps),
        (middle - begin, time.perf_counter() - middle),
    )


def _run(equation, y, bounds: Limits) -> EndStates:
    """By machine code, if the equation is not too long for it."""
    try:
        return NativeEngine().end_states(equation, y, bounds, until="outcome")
    except Unsupported:
        return JaxEngine().end_states(equation, y, bounds, until="outcome")


def limits(atol, max_steps: int) -> Limits:
    endless = jnp.full(atol.shape, jnp.inf)
    return Limits(jnp.asarray(RTOL), atol, endless, jnp.asarray(max_steps))


# --- rows, in pieces that add up ------------------------------------------------------------
