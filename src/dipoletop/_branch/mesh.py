"""The elements of a window: their ends, their nodes, and interpolation between these.

Elements become longer as a motion is braked. A torque may jump at the ends of elements only, since
the state is a polynomial on each.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._base.chebyshev import collocation_rule
from .._base.guards import beside

NODES = 16  # nodes of an element


class Mesh(NamedTuple):
    """E elements of K nodes each. Times are those since the start of the window."""

    lengths: Float[Array, "E"]
    bends: Float[Array, "E"]
    """κ of the map left + length·(e^{κσ} − 1)/(e^κ − 1), 0 ≤ σ ≤ 1, of each element."""
    times: Float[Array, "E K"]
    """The times of the nodes."""
    tau: Float[Array, "E K"]
    """τ at the nodes, on the element's side of a jump at its end."""
    weights: Float[Array, "E K K"]
    """∫ from the left end of the element to node j = Σ weights[e, j, k] (value at node k)."""
    unseen: Float[Array, ""] | None
    """The time of the first jump that is no end of an element; None if no torque jumps."""


def mesh_of(
    time: Any, span: Any, bend: Any, elements: int, jumps: Float[Array, "j"] | None
) -> Mesh:
    """Return the elements of a window.

    Args:
        time: τ at the start of the window.
        span: its length.
        bend: κ of the whole window.
        elements: the number of elements.
        jumps: the τ at which a torque jumps, or None.
    """
    sigma, integral, _ = (jnp.asarray(table, bend.dtype) for table in collocation_rule(NODES))
    along, unseen = _ends(span, bend, elements, None if jumps is None else jumps - time)
    ends = span * jnp.expm1(bend * along) / jnp.expm1(bend)
    lengths, bends = jnp.diff(ends), bend * jnp.diff(along)
    inside = bends[:, None] * sigma[None]
    shares = lengths / jnp.expm1(bends)
    times = ends[:-1, None] + shares[:, None] * jnp.expm1(inside)
    weights = integral[None] * ((shares * bends)[:, None] * jnp.exp(inside))[:, None, :]
    tau = time + times
    if jumps is not None:  # nodes at the ends keep to the side of their element
        middle = (tau[:, :1] + tau[:, -1:]) / 2
        before = jnp.max(jnp.where(jumps[None] <= middle, jumps[None], -jnp.inf), axis=1)
        after = jnp.min(jnp.where(jumps[None] > middle, jumps[None], jnp.inf), axis=1)
        tau = jnp.clip(tau, beside(before, 1)[:, None], beside(after, -1)[:, None])
    return Mesh(lengths, bends, times, tau, weights, unseen)


def _ends(
    span: Any, bend: Any, elements: int, jumps: Float[Array, "j"] | None
) -> tuple[Float[Array, "k"], Float[Array, ""] | None]:
    """Return the ends of the elements, 0 … 1 along the window, and the first jump beside them.

    Each jump within the window moves the end next to it; where there are more jumps than ends, the
    first ones do.
    """
    regular = jnp.arange(elements + 1, dtype=jnp.result_type(bend))
    if jumps is None:
        return regular / elements, None
    jumps = jnp.sort(jnp.where(jumps > 0, jumps, jnp.inf))
    again = jnp.append(False, jumps[1:] == jumps[:-1])
    jumps = jnp.sort(jnp.where(again, jnp.inf, jumps))
    first = jnp.pad(jumps, (0, elements), constant_values=jnp.inf)[: elements - 1]
    within = first < span
    share = jnp.where(within, first, span) / span * jnp.expm1(bend)
    place = elements * jnp.log1p(share) / bend
    order = jnp.arange(1, elements, dtype=place.dtype)
    # As near as possible to their places, but each jump has an end of its own.
    index = jnp.maximum(jax.lax.cummax(jnp.round(place) - order), 0) + order
    most = elements - 1 - jnp.sum(within.astype(order.dtype)) + order
    index = jnp.where(within, jnp.minimum(index, most), float(elements))
    index, place = (jnp.concatenate([regular[:1], x, regular[-1:]]) for x in (index, place))
    ends = jnp.interp(regular, index, place)
    unseen = jnp.min(jnp.where(jumps > jnp.max(jnp.where(within, first, 0.0)), jumps, jnp.inf))
    return ends / elements, unseen


def evaluate(
    mesh: Mesh, values: Float[Array, "E K n"], times: Float[Array, "T"]
) -> Float[Array, "T n"]:
    """Interpolate values at the nodes to times since the start of the window."""
    left, right = mesh.times[:, 0], mesh.times[:, -1]
    element = jnp.sum(times[:, None] > right[None, :-1], axis=1)
    share = (times - left[element]) / (right - left)[element]
    bend = mesh.bends[element]
    sigma = jnp.log1p(share * jnp.expm1(bend)) / bend
    x = jnp.clip(2 * sigma - 1, -1.0, 1.0)
    basis = chebyshev(x)
    transform = jnp.asarray(collocation_rule(NODES).coefficients, x.dtype)
    coefficients = jnp.einsum("kj,ejn->ekn", transform, values, precision="highest")
    here = coefficients[element]
    return jnp.einsum("kt,tkn->tn", jnp.stack(basis), here, precision="highest")


def chebyshev(x: Array) -> list[Array]:
    """Return the first NODES Chebyshev polynomials, on [−1, 1]."""
    basis = [jnp.ones_like(x), x]  # by recurrence: arccos has no derivative at the ends
    while len(basis) < NODES:
        basis.append(2 * x * basis[-1] - basis[-2])
    return basis
