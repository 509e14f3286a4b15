"""The atlas of slow motions: how bodies that radiate weakly end, over all shapes or all dipoles.

Every map is over a triangle. The triangle of bodies has coordinates J₁/J₃ and J₂/J₃, with the
needle (0, 1), the disc (½, ½) and the sphere (1, 1) at its corners. The triangle of dipoles has the
squared direction cosines n₁², n₂², n₃² as coordinates, since the slow flow is linear in them. A
triangle has n² equal cells, each evaluated at its centroid. The directions of L are isotropic.
"""

import dataclasses
import enum

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ._averaging.isotropic_ends import isotropic_ends
from ._averaging.slow_flow import Side
from ._base.checks import instance
from ._base.pictured import Pictured
from ._base.refusals import refuse
from ._base.roots import bisect
from ._base.summaries import span
from ._base.tolerances import whole
from ._base.types import RESIDUAL_FATES, Fate
from .bodies import Body
from .particles import Particle

BODY_CORNERS = np.array([[0.0, 1.0], [0.5, 0.5], [1.0, 1.0]])
"""J₁/J₃ and J₂/J₃ of the needle, the disc and the sphere."""


class Ending(enum.IntEnum):
    """How a body ends, over all directions of L."""

    RESIDUAL = 0
    """Residual rotation from every start."""
    BOTH = 1
    """Residual rotation or a stop, depending on the start."""
    SPIN_1 = 2
    """A stop about the axis of J₁, the smallest moment, from every start."""
    SPIN_3 = 3
    """A stop about the axis of J₃, the largest moment, from every start."""
    TUMBLING_LOW = 4
    """A stop while tumbling about the axis of J₃, from every start."""
    TUMBLING_HIGH = 5
    """A stop while tumbling about the axis of J₁, from every start."""
    STOPS = 6
    """One of two kinds of stop, depending on the start."""


STOPS_AT = {
    Fate.AXIS_1: Ending.SPIN_1,
    Fate.AXIS_3: Ending.SPIN_3,
    Fate.TUMBLING_LOW: Ending.TUMBLING_LOW,
    Fate.TUMBLING_HIGH: Ending.TUMBLING_HIGH,
}
"""The endings with one kind of stop, by its fate."""


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Atlas(Pictured):
    """Ends over the n² cells of a triangle.

    Attributes:
        dipole_axis: 1, 2 or 3, the principal axis with the dipole; None if the map is over dipoles.
        n: cells along an edge of the triangle.
        corners: barycentric coordinates of the corners of every cell, shape (N, 3, 3): weights of
            the needle, the disc and the sphere; or n₁², n₂², n₃².
        moments: J₁/J₃, J₂/J₃ and 1, shape (N, 3).
        dipole: direction cosines of the dipole with the axes of J₁, J₂, J₃, shape (N, 3).
        probability: mean probability over isotropic L of each `Fate` from POSITIVE to WOBBLING,
            shape (N, 8).
        ratio: mean L∞/L₀ over isotropic L, shape (N,).
        error: the largest estimated relative error of a start, shape (N,).
    """

    dipole_axis: int | None
    n: int
    corners: Float[np.ndarray, "N 3 3"]
    moments: Float[np.ndarray, "N 3"]
    dipole: Float[np.ndarray, "N 3"]
    probability: Float[np.ndarray, "N 8"]
    ratio: Float[np.ndarray, "N"]
    error: Float[np.ndarray, "N"]

    @property
    def residual(self) -> Float[np.ndarray, "N"]:
        """The share of directions of L that lead to residual rotation."""
        return np.sum(self.probability[:, RESIDUAL_FATES], axis=1)

    @property
    def ending(self) -> Int[np.ndarray, "N"]:
        """The end of each body over all directions of L, a member of `Ending`."""
        stops = self.probability[:, list(STOPS_AT)]
        ending = np.array(list(STOPS_AT.values()))[np.argmax(stops, axis=1)]
        ending = np.where(np.sum(stops > 0, axis=1) > 1, Ending.STOPS, ending)
        ending = np.where(self.residual > 0, Ending.BOTH, ending)
        return np.where(np.all(stops == 0, axis=1), Ending.RESIDUAL, ending)

    def columns(self) -> dict[str, Float[np.ndarray, "N"]]:
        """Return the numbers of every cell, by name."""
        vectors = {"J": self.moments, "n": self.dipole}
        named = {f"{letter}{k + 1}": v[:, k] for letter, v in vectors.items() for k in range(3)}
        return named | {
            "ending": self.ending,
            "residual": self.residual,
            "ratio": self.ratio,
            "error": self.error,
        }

    def __repr__(self) -> str:
        """The shares of the endings, the range of L∞/L₀ and its mean."""
        counts = np.bincount(self.ending, minlength=len(Ending)) / self.ratio.size
        shares = ", ".join(
            f"{Ending(k).name} {share:.3g}" for k, share in enumerate(counts) if share
        )
        if self.dipole_axis is None:
            j1, j2, _ = self.moments[0]
            what = f"dipoles of J₁/J₃ = {j1:.4g}, J₂/J₃ = {j2:.4g}"
        else:
            what = f"bodies with the dipole on axis {self.dipole_axis}"
        ratio = f"ratio={span(self.ratio)}, mean {np.mean(self.ratio):.3g}"
        return f"Atlas({self.ratio.size} {what}; {shares}; {ratio})"


def atlas(
    dipole: int | None = None,
    *,
    body: Body | Particle | None = None,
    n: int = 32,
    progress: bool = False,
) -> Atlas:
    """Compute how slow motions end, over all bodies with the dipole on one axis, or all dipoles.

    Probabilities and L∞/L₀ are means over isotropic L, by a fixed quadrature over h = 2E/L².

    Args:
        dipole: the principal axis with the dipole, 1 (smallest moment), 2 or 3, for a map over
            J₁/J₃ and J₂/J₃. Give either this or `body`.
        body: a body with three different moments, for a map over all directions of its dipole.
        n: cells along an edge; the map has n² cells, which take some 10 ms each.
        progress: whether to show a progress bar.

    Returns:
        An `Atlas`; `plots.atlas` draws it.

    Raises:
        ValueError: neither or both of `dipole` and `body`; a `dipole` that is not an axis; a `body`
            with equal moments; an `n` below 2.

    Example:
        >>> import dipoletop as dt
        >>> dt.atlas(3, n=2)
        Atlas(4 bodies with the dipole on axis 3; RESIDUAL 1; ratio=0.465994 to 0.531225, mean 0.5)
    """
    if (dipole is None) == (body is None):
        refuse("dipole", "be given or else `body`", "neither is" if dipole is None else "both are")
    corners = cells(whole("n", n, 2, "be an integer of at least 2"))
    middles = np.mean(corners, axis=1)
    if dipole is not None:
        if isinstance(dipole, bool) or dipole not in (1, 2, 3):
            refuse("dipole", "be 1, 2 or 3, a principal axis", f"is {dipole!r}")
        moments = np.concatenate([middles @ BODY_CORNERS, np.ones((n * n, 1))], axis=1)
        dipoles = np.broadcast_to(np.eye(3)[dipole - 1], moments.shape)
    else:
        moments = np.broadcast_to(_three_moments(body), middles.shape)
        dipoles = np.sqrt(middles)
    means = isotropic_ends(moments, dipoles, progress)
    return Atlas(dipole, n, corners, moments, dipoles, *means)


def cells(n: int) -> Float[np.ndarray, "N 3 3"]:
    """Return the barycentric coordinates of the corners of the n² cells of a triangle."""
    found = []
    for i in range(n):
        for j in range(n - i):
            up = [(i, j), (i + 1, j), (i, j + 1)]
            down = [(i + 1, j), (i + 1, j + 1), (i, j + 1)]
            found += [up] if i + j == n - 1 else [up, down]
    first = np.array(found) / n
    return np.concatenate([first, 1 - np.sum(first, axis=-1, keepdims=True)], axis=-1)


def _three_moments(body: Body | Particle | None) -> Float[np.ndarray, "3"]:
    """Return J₁/J₃, J₂/J₃ and 1, after checking that they differ."""
    instance("body", body, Body | Particle, "be a Body or a Particle")
    inertia = np.asarray(body.inertia)  # pyright: ignore[reportOptionalMemberAccess]
    if inertia.ndim != 2:
        refuse("body", "be a single one", "is a batch of them")
    moments = np.linalg.eigvalsh(inertia / np.trace(inertia))
    moments = moments / moments[2]
    if np.min(np.diff(moments)) < 1e-12:
        shown = ", ".join(f"{moment:.6g}" for moment in moments)
        refuse("body", "have three different moments", f"has moments in the ratios {shown}")
    return moments


def spin_border(ratios: Float[np.ndarray, "K"]) -> Float[np.ndarray, "K"]:
    """Return J₂/J₃ against J₁/J₃ on the border of a stop in pure spin about J₃, dipole on J₂.

        J₂J₁² = (J₃ − J₂)(J₃ − J₁)²,

    with pure spin below and tumbling above; on it f′ = 0 at the axis of J₃.

    Source: the slow flow at its extreme axes.
    """
    return (1 - ratios) ** 2 / ((1 - ratios) ** 2 + ratios**2)


def saddle_node_border(ratios: Float[np.ndarray, "K"]) -> Float[np.ndarray, "K"]:
    """Return the J₂/J₃ at given J₁/J₃ above which a dipole on J₁ always gives residual rotation.

    Below it the slow flow around J₃ has a tumbling attractor and a repeller, which merge there in a
    saddle-node bifurcation. It exists for 0.3848 < J₁/J₃ < 2/3, and is NaN elsewhere.
    """
    ratios = np.asarray(ratios, float)
    found = np.asarray(_saddle_nodes(jnp.asarray(ratios)))
    lowest = np.maximum(ratios, 1 - ratios)
    inside = (found > lowest + 1e-9) & (found < 1 - 1e-9)
    return np.where(inside, found, np.nan)


@jax.jit
def _saddle_nodes(ratios: Float[Array, "K"]) -> Float[Array, "K"]:
    """Find by bisection where F of a dipole on J₁ becomes positive everywhere around J₃."""
    positions = jnp.linspace(-8.0, 12.0, 801)  # logit x

    def positive(j1: Float[Array, ""], j2: Float[Array, ""]) -> Array:
        one = jnp.ones(())
        side = Side(jnp.stack([j1, j2, one]), jnp.array([1.0, 0.0, 0.0]))
        return jnp.all(jax.vmap(side.growth)(positions) > 0)

    low, high = jnp.maximum(ratios, 1 - ratios) + 1e-10, jnp.full_like(ratios, 1 - 1e-10)
    both = bisect(lambda j2: jax.vmap(positive)(ratios, j2), low, high, 40)
    return (both[0] + both[1]) / 2
