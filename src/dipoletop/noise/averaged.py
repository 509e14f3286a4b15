"""Noise averaged over free rotation: paths of bodies that turn far too often to be followed.

E and |L| change little during a turn. Their diffusion has the mean over free rotation of the drift
and of D at given E and L. Instead of the means, every step begins at a random phase of the free
rotation, and changes P by the forces there: in the limit of short steps both give the same paths of
(E, |L|), for a body of any shape, on its axes and across the separatrix, where the coefficients of
the former are singular.

A random phase: with the notation of `free_rotation`, L_a = A cos φ and L_b = B sin φ, and the time
spent at φ is proportional to dφ/|L_c|. So a new φ, drawn evenly, is taken with the probability
min(1, |L_c|/|L_c(φ)|), or else the present one is kept: this leaves the distribution over the orbit
as it is in time (Metropolis). A path that crosses the separatrix enters the well in which its L
lies, so that every phase has its share.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._averaging.principal_axes import equal_where_rounded, principal_axes
from .._base.checks import NumberLike, instance, positive
from .._base.compiling import compiled_soon
from .._base.directions import spread_directions
from .._base.linalg import matvec
from .._base.refusals import refuse
from .._base.types import State, Vector
from ..bodies import Body
from .bath import Bath, Kicks
from .ensembles import Ensemble
from .paths import follow, kicked, schedule, starts_of, times

CHANGE = 0.1
"""The largest relative change of P by friction in a step, by default."""


class _Averaged(eqx.Module):
    """A random phase, and then the forces; P in principal axes."""

    kicks: Kicks
    moments: Float[Array, "3"]
    """J₁ ≤ J₂ ≤ J₃."""

    @property
    def draws(self) -> int:
        """The number of random numbers of a step: two for the phase."""
        return 2 + self.kicks.draws

    def __call__(self, t: Any, y: State, h: Any, z: Float[Array, "d *#lanes"]) -> State:
        """Return P at t + h."""
        momentum = random_phase(self.moments, y, z[:2])

        def change(momentum: Vector, t: Any) -> Vector:
            return self.kicks.thermal(momentum, h, z[2:]) + h * self.kicks.radiated(momentum)

        return kicked(change, momentum)


def random_phase(
    moments: Float[Array, "3"], momentum: Vector, z: Float[Array, "2 *#lanes"]
) -> Vector:
    """Return L at a random phase of its free rotation.

    Args:
        moments: J₁ ≤ J₂ ≤ J₃.
        momentum: L in principal axes.
        z: two independent normal numbers, whose direction is φ, while exp(−|z|²/2) decides.
    """
    j1, j2, j3 = moments
    p12, p23 = (j2 - j1) / (j1 * j2), (j3 - j2) / (j2 * j3)
    p13 = p12 + p23
    first, middle, last = momentum
    high = (p12 * first**2 > p23 * last**2) | (p23 == 0)
    a, c = jnp.where(high, last, first), jnp.where(high, first, last)
    to_b = jnp.where(high, p12, p23)  # Db; Da = p13 either way
    ratio = to_b / jnp.where(p13 > 0, p13, 1.0)  # A²/B²
    around = a**2 + ratio * middle**2  # A²
    across = middle**2 + a**2 / jnp.where(ratio > 0, ratio, 1.0)  # B²
    squares = z[0] ** 2 + z[1] ** 2
    length = jnp.sqrt(jnp.where(squares > 0, squares, 1.0))
    new_a = jnp.sqrt(around) * (z[0] / length)
    new_b = jnp.sqrt(across) * (z[1] / length)
    rest = a**2 + middle**2 + c**2 - new_a**2 - new_b**2
    new_c = jnp.where(c < 0, -1.0, 1.0) * jnp.sqrt(jnp.maximum(rest, 0.0))
    taken = (jnp.exp(-squares / 2) * jnp.abs(new_c) <= jnp.abs(c)) & (ratio > 0)
    a, b, c = (jnp.where(taken, new, old) for new, old in ((new_a, a), (new_b, middle), (new_c, c)))
    return jnp.stack([jnp.where(high, c, a), b, jnp.where(high, a, c)])


def averaged_ensemble(
    body: Body,
    bath: Bath,
    omega0: Any,
    ts: Any,
    *,
    n: int = 1000,
    seed: int = 0,
    step: NumberLike | None = None,
) -> Ensemble:
    """Follow n paths of a body in a bath, averaged over its free rotation.

    The cost does not depend on τ₀Ω: a step lasts as long as friction changes L by a tenth. It
    holds where a turn is short beside that.

    Args:
        body: the body; for a particle `particle.body()`, with `Bath.around(particle, …)`.
        bath: the bath.
        omega0: ω₀ of all paths, shape (3,), or of each, shape (n, 3), dimensionless.
        ts: the times τ to save, ascending, at least two; paths begin at the first one.
        n: the number of paths.
        seed: seed of the noise; path i depends on (seed, i) only, not on n.
        step: the relative change of L by friction or noise in a step; None means 0.1, for means
            with an error of some 0.2 %. It is proportional to the step.

    Returns:
        An `Ensemble`: energies and sizes of L, and ω at a random phase of the rotation. It has no
        attitudes.

    Raises:
        ValueError: bad arguments; a turn that is not short beside the time of friction.

    Example:
        >>> import dipoletop as dt
        >>> body = dt.Body([[1.0, 0, 0], [0, 1.3, 0], [0, 0, 1.9]], [0.6, 0.8, 0.0])
        >>> bath = dt.noise.Bath(heat=1e-40)
        >>> times = [0.0, 3e41]
        >>> found = dt.noise.averaged_ensemble(body, bath, [0, 0, 1e-20], times, n=2000)
        >>> energy, error = found.mean(found.energy[:, -1])
        >>> bool(abs(energy / 1e-40 - 1.5) < 4 * error / 1e-40 + 0.02)
        True
    """
    instance("body", body, Body)
    instance("bath", bath, Bath)
    if body.inertia.ndim != 2:
        refuse("body", "be a single one", "is a batch of them")
    given = times(ts)
    change = CHANGE if step is None else float(positive("step", step, batch=False))
    starts = jnp.asarray(starts_of(omega0, n))
    averaged, axes, momenta, *rates = _prepared(body, bath, starts, bath.acting)
    bounds = _Rates(*map(float, rates))
    _refuse_slow_turns(averaged.moments, bounds)
    plan = schedule(given, lambda t: change / bounds.fastest(t - float(given[0])))
    found = follow(averaged, momenta, plan, seed)
    omega = (found / np.asarray(averaged.moments)) @ np.asarray(axes).T
    return Ensemble(given, omega, None, body)


@compiled_soon
def _prepared(
    body: Body, bath: Bath, starts: Float[Array, "3 N"], acting: tuple[bool, bool]
) -> tuple[Any, ...]:
    """Return the step, the principal axes, P at the start in them, and the numbers of `_Rates`."""
    moments, axes = principal_axes(body.inertia)
    moments = equal_where_rounded(moments)
    inner = Body(jnp.diag(moments), axes.T @ body.dipole)
    tensors = tuple(axes.T @ matrix @ axes for matrix in (bath.drag, bath.diffusion))
    turned = eqx.tree_at(lambda bath: (bath.drag, bath.diffusion), bath, tensors)
    kicks = Kicks(inner, turned, acting)
    momenta = moments[:, None] * (axes.T @ starts)
    unit = jnp.asarray(spread_directions(DIRECTIONS).T)
    braking = jnp.max(jnp.linalg.norm(kicks.radiated(unit), axis=0))
    columns = [kicks.field(unit, jnp.broadcast_to(a[:, None], unit.shape)) for a in jnp.eye(3)]
    spread = bath.heat * jnp.max(sum(jnp.sum(each**2, axis=0) for each in columns))
    slowed = matvec(kicks.drag, matvec(kicks.inverse, unit))
    others = spread + jnp.max(jnp.linalg.norm(slowed, axis=0))
    thermal = HOT * turned.highest * moments[2]
    square = jnp.max(jnp.sum(momenta**2, axis=0))
    return _Averaged(kicks, moments), axes, momenta, square, thermal, braking, others


class _Rates(NamedTuple):
    """Bounds of the relative rates at which P changes, over all directions of P."""

    square: float
    """The largest L² at the start."""
    thermal: float
    """L² of a hot path in equilibrium."""
    braking: float
    """The rate of radiation reaction at L = 1, which grows as L²."""
    others: float
    """The rate of drag and of the noise of radiation, for any L."""

    def fastest(self, t: float) -> float:
        """Return the fastest relative rate at the time t after the start.

        A path with a slow direction keeps its L for longer, but changes more slowly in all.
        """
        slowed = self.square / (1 + SLOWEST * self.braking * self.square * t)
        rate = self.braking * (slowed + self.thermal) + self.others
        return max(rate, float(np.finfo(float).tiny))


def _refuse_slow_turns(moments: Float[Array, "3"], bounds: _Rates) -> None:
    """Refuse a body whose L, at its usual size, moves in the body no faster than friction acts."""
    (j1, _, j3), size = np.asarray(moments), np.sqrt(max(bounds.square, bounds.thermal / HOT))
    rate, libration = bounds.fastest(0.0), size * (j3 - j1) / (j1 * j3)
    if libration > 0 and rate > LARGEST * libration:  # L of a sphere does not move
        must = "make the body turn much faster than friction acts (`ensemble` follows every turn)"
        refuse("omega0", must, f"makes the rates {libration:.2g} and {rate:.2g}")


LARGEST = 0.1  # rate of friction over that of the motion of L in the body
DIRECTIONS = 400
HOT = 8.0  # L² of all but two paths in a hundred is below this times J₃kT
SLOWEST = 0.1  # the rate of braking of most directions over the largest one
