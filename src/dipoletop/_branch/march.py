"""Motions along the physical branch of a full equation, window after window.

Each window is a boundary-value problem (`window`) that extends several runaway e-foldings past the
part that is kept. The next window begins at the end of the elements that meet the tolerance; its
length depends on the number of these elements. It solves for the fast components anew.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .._base.compiling import compiled_soon
from .._base.dependence import dependence
from .._base.roots import bisect
from .._base.structure import of_structure, state_of
from ..equations._common import energy_flows, slow_start
from .mesh import evaluate
from .turning import advance_turning, attitudes, start_turning
from .window import Window, solve_window

EFOLDS = 36.0  # e-foldings of a runaway in a first window: −ln of the rounding error of float64
UNAWARE = 5.0  # e-foldings more than −ln rtol from which a later jump is not felt
LONGER = 1.6  # factor of the length if only the error at the far end is too large
FACTORS = (0.5, 0.8, 1.0, 1.3, 1.7)  # factors of the length otherwise, if 0, 1/4, … 1 is accepted
PREVIOUS_ELEMENT = 30.0  # factor by which an element's truncation is smaller in the one before
UNRESOLVED = 1e3  # largest growth of a change at the far end of a long window
MOST_REJECTED = 14  # consecutive rejected windows
PATIENT = 3  # consecutive rejected windows after which windows are cut faster and faster


class MarchState(NamedTuple):
    """The progress of a march, and the length of its next window."""

    time: Float[Array, ""]
    slow: Float[Array, "m"]
    """The slow part of the state; it begins with ω."""
    span: Float[Array, ""]
    windows: Int[Array, ""]
    """The number of windows tried."""
    rejected: Int[Array, ""]
    """The number of consecutive windows without an accepted element."""

    @property
    def failed(self) -> Bool[Array, ""]:
        """Whether no physical branch can be found from here."""
        return self.rejected >= MOST_REJECTED


@of_structure
def depends_on_time(equation: Any) -> bool:
    """Return whether the rates of a full equation may depend on τ."""
    kinds, rest = eqx.partition(equation, lambda leaf: isinstance(leaf, jax.ShapeDtypeStruct))
    leaves, structure = jax.tree.flatten(kinds)
    state = state_of(equation)

    def rates(time: Any, state: Any, *leaves: Any) -> Any:
        return eqx.combine(jax.tree.unflatten(structure, leaves), rest)(time, state)

    return any(dependence(rates, jax.ShapeDtypeStruct((), state.dtype), state, *leaves)[0])


def start_march(equation: Any, omega0: Float[Array, "3"], time: Any) -> MarchState:
    """Return a march at ω₀, before its first window."""
    slow, time = slow_start(equation, omega0), jnp.asarray(time, omega0.dtype)
    size, rate = (jnp.max(jnp.abs(x)) for x in (omega0, equation.semi(time, slow)[:3]))
    span = EFOLDS / equation.runaway_rate + 4 * size / jnp.where(rate > 0, rate, 1.0)
    span = jax.lax.stop_gradient(span)  # no motion depends on it
    none = jnp.zeros((), "int32")
    rejected = jnp.where(jnp.isfinite(size + rate), 0, MOST_REJECTED).astype("int32")
    return MarchState(time, slow, span, none, rejected)


def advance_window(
    equation: Any, state: MarchState, rtol: Float[Array, ""]
) -> tuple[MarchState, Window, Int[Array, ""]]:
    """Try one window.

    Returns:
        The next state, the window, and the number of its first elements that are accepted.
    """
    window = solve_window(equation, state.time, state.slow, state.span, rtol)
    ends, sizes = window.mesh.times[:, -1], window.sizes
    # The truncation of an element also affects the one before, though much less.
    following = jnp.append(window.truncation[1:] * sizes[1:] / sizes[:-1], 0.0)
    resolved = (window.truncation <= rtol) & (following <= PREVIOUS_ELEMENT * rtol)
    decayed = (window.end_error <= rtol) & _is_physical(equation, window)
    if window.mesh.unseen is not None:  # a jump acts on the motion before it, as a runaway decays
        before = jnp.minimum(UNAWARE - jnp.log(rtol), EFOLDS) / equation.runaway_rate
        decayed &= ends <= window.mesh.unseen - before
    accepted = window.converged & resolved & decayed
    count = jnp.sum(jnp.cumprod(accepted.astype("int32")))
    moved, last = count > 0, jnp.maximum(count - 1, 0)
    too_short = window.converged & resolved[0] & ~decayed[0]
    share, shares = count / ends.shape[0], jnp.linspace(0, 1, len(FACTORS))
    factor = jnp.where(too_short, LONGER, jnp.interp(share, shares, jnp.asarray(FACTORS)))
    # A first window may be too long by many orders of magnitude, if the start hardly moves.
    halvings = jnp.maximum(state.rejected - PATIENT, 1).astype(ends.dtype)
    factor = jnp.where(window.converged, factor, 0.5**halvings)
    return (
        MarchState(
            jnp.where(moved, state.time + ends[last], state.time),
            jnp.where(moved, window.states[last, -1, : state.slow.shape[0]], state.slow),
            state.span * factor,
            state.windows + 1,
            jnp.where(moved, 0, state.rejected + 1).astype("int32"),
        ),
        window,
        count,
    )


def _is_physical(equation: Any, window: Window) -> Bool[Array, ""]:
    """Return whether changes at the far end of a window decay towards its left end.

    They grow if the levels that give the end value agree on a runaway. In windows much longer than
    the time of a runaway they then grow by many orders of magnitude. Otherwise they may be as large
    at the left end: elements that are too long for collocation to resolve a decay keep them.
    """
    long = equation.runaway_rate * window.span > EFOLDS
    return window.retained < jnp.where(long, UNRESOLVED, 1.0)


class BranchMotion(NamedTuple):
    """The physical motion at given times; NaN where it was not found."""

    states: Float[Array, "T n"]
    energies: Float[Array, "T k"]
    """∫`energy_flows` dτ from the first time on."""
    windows: Int[Array, ""]
    reached: Float[Array, ""]
    """The time up to which the motion was found."""
    attitude: Float[Array, "T 4"] | None = None
    """Unit quaternions, relative to the first time."""


@compiled_soon
def follow(
    equation: Any,
    omega0: Float[Array, "3"],
    times: Float[Array, "T"],
    rtol: Float[Array, ""],
    max_windows: Any,
    attitude: bool = False,
) -> BranchMotion:
    """Return the physical motion of a full equation from ω₀ at times[0] on, forwards.

    Args:
        equation: a full equation.
        omega0: start, shape (3,).
        times: shape (T,), increasing.
        rtol: tolerance of each window, relative to |ω|.
        max_windows: the largest number of windows, and of the pieces of `turning`.
        attitude: whether the attitude is wanted.
    """
    flows = functools.partial(energy_flows, equation)

    def unfinished(carry: Any) -> Bool[Array, ""]:
        state, _, _, turning = carry
        going = (state.time < times[-1]) & ~state.failed & (state.windows < max_windows)
        return going if turning is None else going & (turning.pieces < max_windows)

    def advance(carry: Any) -> Any:
        state, output, total, turning = carry
        new, window, accepted = advance_window(equation, state, rtol)
        rates = jax.vmap(jax.vmap(flows))(window.mesh.tau, window.states)
        inside = jnp.einsum("ejk,eki->eji", window.mesh.weights, rates, precision="highest")
        before = jnp.cumsum(inside[:, -1], axis=0) - inside[:, -1]
        energies = total[None, None] + before[:, None] + inside
        values = jnp.concatenate([window.states, energies], axis=-1)
        wanted = (times >= state.time) & (times <= new.time) & (accepted > 0)
        here = evaluate(window.mesh, values, jnp.where(wanted, times - state.time, 0.0))
        total = jnp.where(accepted > 0, energies[jnp.maximum(accepted - 1, 0), -1], total)
        if turning is not None:
            since = jnp.where(wanted, times - state.time, -1.0)
            asked = {"accepted": accepted, "since": since, "rtol": rtol, "most": max_windows}
            turning = advance_turning(equation, window, turning, **asked)
            # A motion whose turns are not known to the end of the window has not reached it.
            time = jnp.where(turning.pieces < max_windows, new.time, state.time)
            new = new._replace(time=time)
        return new, jnp.where(wanted[:, None], here, output), total, turning

    state = state_of(equation)
    n, k = state.shape[0], jax.eval_shape(flows, times[0], state).shape[0]
    # NaN that depends on ω₀, so that its derivatives are NaN, too: a constant's would be 0.
    output = jnp.broadcast_to(jnp.nan * omega0[0], (times.shape[0], n + k))
    turning = start_turning(omega0, times.shape[0]) if attitude else None
    begun = start_march(equation, omega0, times[0]), output, jnp.zeros(k, omega0.dtype), turning
    state, output, _, turning = jax.lax.while_loop(unfinished, advance, begun)
    turned = None if turning is None else attitudes(equation, turning)
    return BranchMotion(output[:, :n], output[:, n:], state.windows, state.time, turned)


def crossing(
    equation: Any,
    omega0: Float[Array, "3"],
    function: Callable[[Array], Array],
    rtol: Float[Array, ""],
    max_windows: Any,
) -> Float[Array, ""]:
    """Return the first time at which a function of the state falls to 0 on the motion from ω₀.

    The motion is the physical one. The sign is tested at the ends of the elements of windows; NaN
    if the function never falls to 0 there. Differentiable in forward mode.
    """

    def unfinished(carry: Any) -> Bool[Array, ""]:
        state, *_, below = carry
        return ~jnp.any(below) & ~state.failed & (state.windows < max_windows)

    def advance(carry: Any) -> Any:
        state, *_ = carry
        new, window, accepted = advance_window(equation, state, rtol)
        below = jax.vmap(function)(window.states[:, -1]) <= 0
        return new, state.time, window, below & (jnp.arange(below.size) < accepted)

    state = start_march(equation, omega0, 0.0)
    _, window, _ = jax.eval_shape(lambda state: advance_window(equation, state, rtol), state)
    window = jax.tree.map(lambda kind: jnp.zeros(kind.shape, kind.dtype), window)
    begun = state, state.time, window, jnp.zeros(window.mesh.times.shape[0], bool)
    _, before, window, below = jax.lax.while_loop(unfinished, advance, begun)

    def state_at(time: Array) -> Array:
        return evaluate(window.mesh, window.states, time[None])[0]

    which = jnp.argmax(below)
    early = jnp.where(which > 0, window.mesh.times[which - 1, -1], 0.0)
    bracket = bisect(lambda t: function(state_at(t)) <= 0, early, window.mesh.times[which, -1], 50)
    time = jax.lax.stop_gradient(bracket[0])
    for _ in range(2):  # Newton's method, since bisection has no derivatives
        y = state_at(time)
        value, slope = jax.jvp(function, (y,), (equation(before + time, y),))
        time = time - value / slope
    # NaN that depends on ω₀, so that its derivatives are NaN, too.
    return jnp.where(jnp.any(below), before + time, jnp.nan * omega0[0])
