"""The physical branch of the full equations: where it is, and how to follow it forwards.

Forwards in time a full equation runs away from its physical solutions, backwards it is drawn to
them. So they are found window by window (`_windows`), each a boundary-value problem whose far end
lies some runaway times ahead of what is kept of it.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int

from .. import radiation
from .._base.checks import check_single, finite, or_nan, refuse
from .._base.forward_mode import differentiable
from .._base.tolerances import tolerance
from . import window as _windows
from .window import Window

EFOLDS = 36.0  # runaway times that a first window looks ahead
LONGER, SHORTER = 1.6, (0.5, 0.8, 1.0, 1.3, 1.7)  # of windows, by the number of good elements
REACHES = 30.0  # an element may be this much worse than rtol, if only the one before it is kept
TRIES = 14  # windows in a row of which nothing holds


def is_full(equation: Any) -> bool:
    """Whether an equation has runaways, and so a physical branch to be followed."""
    return hasattr(equation, "runaway_rate")


def physical(equation: Any) -> Any:
    """What runs from a start ω₀ are made with: the equation, or its branch, if it has that one.

    A full equation may know an equation of its physical motions without runaways, `branch`.
    """
    return getattr(equation, "branch", equation)


def slow_manifold(equation: Any, omega: Any, *, rtol: Any = None, with_error: bool = False) -> Any:
    """Ω̇ on the physical branch of a full equation at the angular velocity Ω.

    The motion from Ω on is solved for as a boundary-value problem over some runaway times. What
    is assumed at its far end (the asymptotic series) is forgotten exponentially. May be jitted,
    vmapped and differentiated, forwards and backwards.

    Args:
        equation: a full equation, such as `TransverseFull` or `Full`.
        omega: Ω, shape (3,), dimensionless, body axes.
        rtol: the accuracy wanted, relative to the largest component of Ω̇; None means the best
            there is. A larger one takes a shorter stretch, which is found at larger |Ω|, too.
        with_error: also return an estimate of the error.

    Returns:
        Ω̇, shape (3,); NaN where no branch was found, or not to `rtol`. With `with_error` a pair
        of it and the estimated largest error of its components.

    Raises:
        ValueError: bad arguments.

    Example:
        >>> import jax.numpy as jnp, dipoletop as dt
        >>> start = dt.cylindrical(w_perp=0.2, w3=0.2, phi=jnp.pi / 30)
        >>> rate = dt.slow_manifold(dt.TransverseFull(-0.2), start)
        >>> [f"{x:.8f}" for x in rate.tolist()]
        ['-0.00083623', '0.00913023', '-0.00967855']
    """
    if not is_full(equation):
        refuse("equation", "be a full equation", f"is {type(equation).__name__}")
    check_single(equation)
    start = finite("omega", omega, (3,), batch=False)
    wanted = jnp.asarray(jnp.inf) if rtol is None else tolerance("rtol", rtol)
    if physical(equation) is not equation:
        rate, error = _known_branch(equation, start, wanted)
        return (rate, error) if with_error else rate
    arrays, rest = eqx.partition(equation, eqx.is_inexact_array)
    x, back = ravel_pytree((arrays, start))

    def found(x: Array, wanted: Array) -> Array:
        arrays, omega = back(x)
        return jnp.append(*_slow_manifold(eqx.combine(arrays, rest), omega, wanted))

    result = differentiable(found)(x, wanted)
    return (result[:3], result[3]) if with_error else result[:3]


def _known_branch(equation: Any, omega: Array, wanted: Array) -> tuple[Array, Array]:
    branch = physical(equation)
    y = branch.lift(omega)
    rate = jax.jvp(branch.omega, (y,), (branch(0.0, y),))[1]
    error = 10 * jnp.finfo(omega.dtype).eps * jnp.max(jnp.abs(rate))
    return or_nan(rate, error <= wanted * jnp.max(jnp.abs(rate))), error


@eqx.filter_jit
def _slow_manifold(equation: Any, omega: Array, wanted: Array) -> tuple[Array, Array]:
    # The far end is to fade below what is wanted, from an error of the size of Ω̇ itself.
    efolds = jnp.where(wanted < 1, jnp.clip(4 - jnp.log(wanted), 8.0, EFOLDS), EFOLDS)
    window = _windows.solve(equation, omega, efolds / equation.runaway_rate)
    rate = equation.omega_dot(window.states[0, 0])
    size = jnp.max(jnp.abs(rate))
    # The far end as it has faded; the last coefficients of each element as a rate, of which the
    # element before feels little; rounding.
    far = window.wrong_end * jnp.exp(-efolds)
    lengths = window.times[:, -1] - window.times[:, 0]
    reached = REACHES ** -jnp.arange(lengths.shape[0], dtype=lengths.dtype)
    faded = jnp.exp(-equation.runaway_rate * window.times[:, 0])
    felt = window.tail * jnp.minimum(reached, faded) / lengths
    lacking = jnp.max(felt) * jnp.max(jnp.abs(omega))
    error = 3 * far + 10 * (lacking + jnp.finfo(omega.dtype).eps * size)
    good = window.converged & ((error <= wanted * size) | (wanted >= 1))
    return or_nan(rate, good), or_nan(error, window.converged)


class Pace(NamedTuple):
    """How far a march has come, and how long its next window shall be."""

    time: Float[Array, ""]
    omega: Float[Array, "3"]
    span: Float[Array, ""]
    windows: Int[Array, ""]
    vain: Int[Array, ""]
    """Windows in a row of which nothing held."""

    @property
    def lost(self) -> Bool[Array, ""]:
        """Whether there is no physical branch to be found from here."""
        return self.vain >= TRIES


def set_out(equation: Any, omega0: Float[Array, "3"], time: Any) -> Pace:
    """A march at its start."""
    size, rate = (jnp.max(jnp.abs(x)) for x in (omega0, equation.semi(0.0, omega0)))
    span = EFOLDS / equation.runaway_rate + 4 * size / jnp.where(rate > 0, rate, 1.0)
    none = jnp.zeros((), "int32")
    vain = jnp.where(jnp.isfinite(size + rate), 0, TRIES).astype("int32")
    return Pace(jnp.asarray(time, omega0.dtype), omega0, span, none, vain)


def march(equation: Any, at: Pace, rtol: Array) -> tuple[Pace, Window, Int[Array, ""]]:
    """Try one window. Returns where it leads, the window, and how many elements of it hold."""
    window = _windows.solve(equation, at.omega, at.span)
    size = jnp.max(jnp.abs(at.omega))
    size = jnp.where(size > 0, size, 1.0)
    ends, runaway = window.times[:, -1], equation.runaway_rate
    # What is wrong at the far end has faded so far where an element ends.
    layer = window.wrong_end / runaway / size * jnp.exp(-runaway * (at.span - ends))
    # What an element lacks also reaches the one before, though much less of it.
    behind = jnp.append(window.tail[1:], 0.0)
    resolved = (window.tail <= rtol) & (behind <= REACHES * rtol)
    forgotten = layer <= rtol
    holds = window.converged & resolved & forgotten
    good = jnp.sum(jnp.cumprod(holds.astype("int32")))
    moved, last = good > 0, jnp.maximum(good - 1, 0)
    too_short = window.converged & resolved[0] & ~forgotten[0]
    factor = jnp.where(too_short, LONGER, jnp.asarray(SHORTER, size.dtype)[good])
    return (
        Pace(
            jnp.where(moved, at.time + ends[last], at.time),
            jnp.where(moved, window.states[last, -1, :3], at.omega),
            at.span * factor,
            at.windows + 1,
            jnp.where(moved, 0, at.vain + 1).astype("int32"),
        ),
        window,
        good,
    )


class Motion(NamedTuple):
    """The physical motion at given times; NaN where it was not found."""

    states: Float[Array, "T n"]
    emitted: Float[Array, "T"]
    """∫|d₂|²dτ since the start."""
    windows: Int[Array, ""]
    reached: Float[Array, ""]
    """Up to which time."""


@eqx.filter_jit
def follow(equation: Any, omega0: Array, times: Array, rtol: Array, max_windows: Any) -> Motion:
    """The physical motion of a full equation from ω₀ at times[0] on, forwards.

    Args:
        equation: a full equation.
        omega0: start, shape (3,).
        times: shape (T,), increasing.
        rtol: tolerance of each window, relative to |ω|.
        max_windows: budget.
    """
    body = equation.body

    def power(y: Array) -> Array:
        return radiation.radiated_power(body, equation.omega(y), equation.omega_dot(y))

    def going(carry: Any) -> Bool[Array, ""]:
        at, _, _ = carry
        return (at.time < times[-1]) & ~at.lost & (at.windows < max_windows)

    def on(carry: Any) -> Any:
        at, found, total = carry
        new, window, good = march(equation, at, rtol)
        powers = jax.vmap(jax.vmap(power))(window.states)
        inside = jnp.einsum("ejk,ek->ej", window.weights, powers, precision="highest")
        before = jnp.cumsum(inside[:, -1]) - inside[:, -1]
        emitted = total + before[:, None] + inside
        values = jnp.concatenate([window.states, emitted[..., None]], axis=-1)
        wanted = (times >= at.time) & (times <= new.time) & (good > 0)
        here = _windows.evaluate(window, values, jnp.where(wanted, times - at.time, 0.0))
        total = jnp.where(good > 0, emitted[jnp.maximum(good - 1, 0), -1], total)
        return new, jnp.where(wanted[:, None], here, found), total

    n = jax.eval_shape(equation.lift, omega0).shape[0]
    # What is not found has no derivative, either: a constant would have the derivative 0.
    found = jnp.broadcast_to(jnp.nan * omega0[0], (times.shape[0], n + 1))
    begun = set_out(equation, omega0, times[0]), found, jnp.zeros((), omega0.dtype)
    at, found, _ = jax.lax.while_loop(going, on, begun)
    return Motion(found[:, :n], found[:, n], at.windows, at.time)


def crossing(equation: Any, omega0: Array, function: Any, rtol: Array, max_windows: Any) -> Array:
    """When a function of the state falls to 0 on the physical motion from ω₀ on, first of all.

    Seen where elements of windows end; NaN if it is not found. Differentiable forwards.
    """

    def going(carry: Any) -> Bool[Array, ""]:
        at, *_, below = carry
        return ~jnp.any(below) & ~at.lost & (at.windows < max_windows)

    def on(carry: Any) -> Any:
        at, *_ = carry
        new, window, good = march(equation, at, rtol)
        below = jax.vmap(function)(window.states[:, -1]) <= 0
        return new, at.time, window, below & (jnp.arange(below.size) < good)

    at = set_out(equation, omega0, 0.0)
    _, window, _ = jax.eval_shape(lambda at: march(equation, at, rtol), at)
    window = jax.tree.map(lambda kind: jnp.zeros(kind.shape, kind.dtype), window)
    begun = at, at.time, window, jnp.zeros(window.times.shape[0], bool)
    _, before, window, below = jax.lax.while_loop(going, on, begun)

    def state(time: Array) -> Array:
        return _windows.evaluate(window, window.states, time[None])[0]

    def halved(_: Any, ends: Any) -> Any:
        early, late = ends
        middle = (early + late) / 2
        low = function(state(middle)) <= 0
        return jnp.where(low, early, middle), jnp.where(low, middle, late)

    which = jnp.argmax(below)
    ends = jnp.where(which > 0, window.times[which - 1, -1], 0.0), window.times[which, -1]
    time, _ = jax.lax.stop_gradient(jax.lax.fori_loop(0, 50, halved, ends))
    for _ in range(2):  # Newton's method, since halving has no derivatives
        y = state(time)
        value, slope = jax.jvp(function, (y,), (equation(0.0, y),))
        time = time - value / slope
    return jnp.where(jnp.any(below), before + time, jnp.nan * omega0[0])  # no derivative, either
