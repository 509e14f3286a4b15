"""Stops of a general body, by averaging over its free rotation.

For |d|²|Ω|/J → 0 radiation is slow, and the motion is free rotation whose energy E and angular
momentum L drift. The exact balance laws, averaged over a period of free rotation, are

    dE/dt = −|d|²⟨Q⟩,   d(L²)/dt = −2|d|²⟨R⟩,   Q = |n₂|²,   R = L·(n₁×n₂),

n₁ and n₂ the first two derivatives of n = d/|d| in space. Their right sides are homogeneous in L,
so the shape of the motion h = 2E/L² obeys one autonomous equation, with ds = 2|d|²L²dt,

    dh/ds = f(h) = (h⟨R⟩ − ⟨Q⟩)/L⁴.

With pᵢ = 1/Jᵢ, J₁ < J₂ < J₃, h runs from p₃ (rotation about J₃) over the separatrix p₂ to p₁.
The averages of squares of Jacobi functions give f in terms of W = E(m)/K(m),
m = (p₁−p₂)(h−p₃)/[(p₂−p₃)(p₁−h)]. With the dipole on J₁, on the side p₃ < h < p₂,

    f = (p₁−h)/(p₁−p₂)·{(p₂−h)[p₁p₂²−2p₁p₂p₃+p₁p₃²−p₂p₃²−hp₂(p₂−p₃)] − W(p₂−p₃)Y/(p₁−p₃)},
    Y = h²(p₁p₂+p₁p₃−2p₂p₃) + h(−2p₁p₂²+p₁p₂p₃−2p₁p₃²+2p₂²p₃+2p₂p₃²) + p₁²(p₂−p₃)² − p₂²p₃²,

which is programmed in units of p₁ = 1. Residual rotation would need h → p₁; a zone with f < 0
is a barrier that h cannot cross.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._base.guards import safe_divisor
from ..._base.types import Flag, Real
from .dipole_frame import DipoleFrame

Nodes = Float[Array, "#nodes *#lanes"]

NODES = 16  # points between p₃ and p₂ at which f is evaluated
AVERAGING_ERROR = 4.0  # error of h over (p₂ − p₃)|d|²|Ω|/J; over the same, the error of f is 1
AGM_STEPS = 6


def flow_at_nodes(body: DipoleFrame) -> Nodes:
    """Return the rate f at the nodes between p₃ and p₂ of `behind_barrier`, dipole on J₁."""
    p2, p3, _ = _reciprocal_moments(body)
    return slow_flow(p2[None], p3[None], _nodes(p2))


def _reciprocal_moments(body: DipoleFrame) -> tuple[Real, Real, Flag]:
    """Return p₂ and p₃ in units of p₁, and whether they are distinct; if not, any other values."""
    a, b = body.ja / body.jd, body.jb / body.jd
    p2, p3 = 1 / jnp.minimum(a, b), 1 / jnp.maximum(a, b)
    resolved = float(jnp.finfo(p2.dtype).eps) ** 0.5
    distinct = (1 - p2 > resolved) & (p2 - p3 > resolved)
    return jnp.where(distinct, p2, 0.8), jnp.where(distinct, p3, 0.6), distinct


def _nodes(like: Real) -> Nodes:
    """Return the nodes as fractions of the way from p₃ to p₂."""
    nodes = (jnp.arange(1, NODES + 1) / (NODES + 1)).astype(like.dtype)
    return jnp.broadcast_to(nodes.reshape((NODES,) + (1,) * like.ndim), (NODES, *like.shape))


def behind_barrier(frame: DipoleFrame, flow: Nodes) -> Flag:
    """Return whether h, with the dipole on the smallest moment, is below a zone in which it falls.

    f < 0 must hold at a node between the state and the separatrix. The distance of that node and
    the size of f must exceed the error of averaging, which is of the order of |d|²|Ω|/J and falls
    with |Ω|. `flow` is f at the nodes.
    """
    a, b = frame.ja / frame.jd, frame.jb / frame.jd
    momentum = frame.w**2 + (a * frame.xa) ** 2 + (b * frame.xb) ** 2
    h = (frame.w**2 + a * frame.xa**2 + b * frame.xb**2) / safe_divisor(momentum)
    p2, p3, distinct = _reciprocal_moments(frame)
    margin = AVERAGING_ERROR * frame.strength * frame.speed / frame.jd
    falling = flow < -margin[None] / AVERAGING_ERROR
    ahead = _nodes(h) >= ((h - p3) / (p2 - p3) + margin)[None]
    return distinct & jnp.any(falling & ahead, axis=0)


def slow_flow(p2: Nodes, p3: Nodes, x: Nodes) -> Nodes:
    """Compute f = dh/ds at h = p₃ + (p₂ − p₃)x, 0 < x < 1, dipole on J₁, in units of p₁."""
    h = p3 + (p2 - p3) * x
    w = _ratio_of_elliptic_integrals((1 - p2) * x / (1 - h))
    y = (
        h**2 * (p2 + p3 - 2 * p2 * p3)
        + h * (-2 * p2**2 + p2 * p3 - 2 * p3**2 + 2 * p2**2 * p3 + 2 * p2 * p3**2)
        + (p2 - p3) ** 2
        - (p2 * p3) ** 2
    )
    first = (p2 - h) * ((p2 - p3) ** 2 - p2 * p3**2 - h * p2 * (p2 - p3))
    return (1 - h) / (1 - p2) * (first - w * (p2 - p3) * y / (1 - p3))


def _ratio_of_elliptic_integrals(m: Nodes) -> Nodes:
    """Compute E(m)/K(m) = 1 − Σ 2ⁿ⁻¹cₙ² by the arithmetic-geometric mean, 0 ≤ m ≤ 0.99."""
    arithmetic, geometric, total, weight = jnp.ones_like(m), jnp.sqrt(1 - m), m / 2, 1.0
    for _ in range(AGM_STEPS):
        half = (arithmetic - geometric) / 2
        arithmetic, geometric = (arithmetic + geometric) / 2, jnp.sqrt(arithmetic * geometric)
        total = total + weight * half**2
        weight = 2 * weight
    return 1 - total


def ends_on_axis(frame: DipoleFrame) -> Flag:
    """Return whether all motions end in a spin about J₃, for a dipole on the middle axis.

    There f ∝ (h − p₃) with the sign of J₂J₁² − (J₃−J₂)(J₃−J₁)²; else the body keeps tumbling.
    """
    low, high = jnp.minimum(frame.ja, frame.jb), jnp.maximum(frame.ja, frame.jb)
    return frame.jd * low**2 < (high - frame.jd) * (high - low) ** 2
