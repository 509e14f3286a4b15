"""The attitude along the physical branch, window after window.

On a window ω is known as a polynomial on each element. The attitude may turn much faster than ω
changes, so an element is cut into pieces of at most RADIANS, or left whole where ω has settled
along the dipole. On each piece the turn (`_base.attitudes`) is found by collocation at as many
nodes as an element has, with an error far below any tolerance. It has no effect on the windows.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .._base.attitudes import attitude_after, no_turn, quaternion_rate, turned_across
from .._base.chebyshev import collocation_rule
from ..equations._common import twist_axis
from .mesh import NODES, chebyshev, evaluate
from .window import Window

RADIANS = 2.0  # the first neglected coefficient, of the size J₁₆(1), is then below 1e-16
PICARD = 18  # iterations of y = y₀ + A f(y), each error at most 1/k of the one before
SETTLED = 1e-2  # tolerances: an element in which p turns less is not cut


class Turning(NamedTuple):
    """The turns that are known so far."""

    turn: Float[Array, "5"]
    """The turn at the time up to which the motion is known."""
    output: Float[Array, "T 5"]
    """The turns at the given times, NaN where they are not known yet."""
    pieces: Int[Array, ""]
    """The number of pieces so far."""


def start_turning(omega0: Float[Array, "3"], count: int) -> Turning:
    """Return the state without a turn of a motion from ω₀ that is wanted at `count` times."""
    # NaN that depends on ω₀, so that its derivatives are NaN, too: a constant's would be 0.
    output = jnp.broadcast_to(jnp.nan * omega0[0], (count, 5))
    return Turning(no_turn(omega0), output, jnp.zeros((), "int32"))


def advance_turning(
    equation: Any,
    window: Window,
    turning: Turning,
    *,
    accepted: Int[Array, ""],
    since: Float[Array, "T"],
    rtol: Float[Array, ""],
    most: Any,
) -> Turning:
    """Follow the attitude through the accepted elements of a window.

    Args:
        equation: a full equation.
        window: the next window.
        turning: the turns up to its left end.
        accepted: the number of its elements that count.
        since: the times since its left end, negative where no turn is wanted.
        rtol: tolerance of the motion.
        most: the largest number of pieces; beyond it the turns are unknown.
    """
    axis = twist_axis(equation)
    counts = _pieces(equation, window, rtol, most)

    accepted = accepted.astype("int32")

    def unfinished(carry: Any) -> Array:
        element, _, now = carry
        return (element < accepted) & (now.pieces < most)

    def advance(carry: Any) -> Any:
        element, piece, now = carry
        left, count = window.mesh.times[element, 0], counts[element]
        span = (window.mesh.times[element, -1] - left) / count
        left = left + piece.astype(span.dtype) * span
        values = _piece(equation, window, axis, now.turn, (left, span))
        x = jnp.clip(2 * (since - left) / span - 1, -1.0, 1.0)
        transform = jnp.asarray(collocation_rule(NODES).coefficients, x.dtype)
        basis = jnp.stack(chebyshev(x))
        here = jnp.einsum("kt,kj,jn->tn", basis, transform, values, precision="highest")
        # Values beyond this piece are overwritten by later pieces.
        output = jnp.where((since >= left)[:, None], here, now.output)
        ended = (piece + 1).astype(span.dtype) >= count
        where = element + ended.astype("int32"), jnp.where(ended, 0, piece + 1)
        return *where, Turning(values[-1], output, now.pieces + 1)

    zero = jnp.zeros((), "int32")
    return jax.lax.while_loop(unfinished, advance, (zero, zero, turning))[-1]


def _pieces(equation: Any, window: Window, rtol: Float[Array, ""], most: Any) -> Float[Array, "E"]:
    """Return the number of pieces of each element."""
    states, times = jax.lax.stop_gradient((window.states, window.mesh.times))
    omegas = jax.vmap(jax.vmap(equation.omega))(states)
    axis = twist_axis(equation)
    along = jnp.einsum("eki,i->ek", omegas, axis, precision="highest")
    across = omegas - along[..., None] * axis[None, None]
    lengths = times[:, -1] - times[:, 0]
    turns, swings = (
        lengths * jnp.sqrt(jnp.max(jnp.sum(part**2, axis=-1), axis=-1)) for part in (omegas, across)
    )
    counts = jnp.clip(jnp.ceil(turns / RADIANS), 1, jnp.asarray(most, turns.dtype))
    return jnp.where(swings <= SETTLED * rtol, 1.0, counts)


def _piece(
    equation: Any, window: Window, axis: Array, turn: Float[Array, "5"], stretch: Any
) -> Float[Array, "K 5"]:
    """Return the turns at the nodes of a piece; `stretch` is its beginning and its length."""
    left, span = stretch
    nodes, integral, _ = (jnp.asarray(table, turn.dtype) for table in collocation_rule(NODES))
    states = evaluate(window.mesh, window.states, left + span * nodes)
    omegas = jax.vmap(equation.omega, out_axes=1)(states)
    along = jnp.einsum("i,ik->k", axis, omegas, precision="highest")
    theta = turn[4] + span * jnp.matmul(integral, along, precision="highest")
    _, across = turned_across(axis[:, None], theta, omegas)

    def iterate(_: Any, p: Float[Array, "4 K"]) -> Float[Array, "4 K"]:
        rates = quaternion_rate(p, across)
        return turn[:4, None] + span * jnp.matmul(rates, integral.T, precision="highest")

    p = jax.lax.fori_loop(0, PICARD, iterate, jnp.broadcast_to(turn[:4, None], (4, NODES)))
    return jnp.concatenate([p, theta[None]]).T


def attitudes(equation: Any, turning: Turning) -> Float[Array, "T 4"]:
    """Return the attitudes at the given times, relative to the first."""
    axis = twist_axis(equation)
    return jax.vmap(lambda turn: attitude_after(turn, axis))(turning.output)
