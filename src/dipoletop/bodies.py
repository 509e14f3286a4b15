"""Rigid bodies with an electric dipole: inertia tensor and dipole moment in body axes.

All quantities are dimensionless with k = 1. Choose a unit of inertia I₁ (one of mass M and one
of length ℓ give I₁ = Mℓ²) and a unit of time τ₀; the unit of dipole moment is then √(I₁τ₀/k), of
charge √(Mτ₀/k), and |d|² says how strongly the body radiates. With I₁ the transverse moment of
an axisymmetric top and τ₀ = k d²/I₁ the dipole has length 1.
"""

import functools
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ._base.checks import concrete, finite, refuse, where_valid

AXES = {"transverse": (1.0, 0.0, 0.0), "longitudinal": (0.0, 0.0, 1.0)}
"""Named directions of the dipole; the symmetry axis is the third."""


class Body(eqx.Module):
    """A rigid body that obeys IΩ̇ + Ω×IΩ = d × d⃛, with k = 1.

    Either argument may have one batch axis in front; the other is then repeated along it.

    Args:
        inertia: Inertia tensor I in body axes, shape (3, 3), in units of I₁.
        dipole: Dipole moment d in body axes, shape (3,), in units of √(I₁τ₀/k).

    Raises:
        ValueError: If `inertia` is not symmetric and positive definite, or its principal moments
            violate J₁ + J₂ ≥ J₃; if `dipole` is zero; if either is not finite or has a wrong
            shape. A rod without thickness is refused: Ω̇ needs the inverse of I. Traced bad values
            become NaN instead.

    Source: equation (3.3).

    Example:
        >>> body = Body([[2, 0, 0], [0, 3, 0], [0, 0, 4]], [0, 0, 1])
        >>> body.moments.tolist()
        [2.0, 3.0, 4.0]
    """

    inertia: Float[Array, "*batch 3 3"]
    dipole: Float[Array, "*batch 3"]

    def __init__(self, inertia: Any, dipole: Any) -> None:
        self.inertia, self.dipole = _same_batch(
            inertia=(_inertia(inertia), 2), dipole=(_nonzero_dipole(dipole), 1)
        )

    @property
    def moments(self) -> Float[Array, "*batch 3"]:
        """Principal moments J₁ ≤ J₂ ≤ J₃ (batch axis, if any, in front)."""
        return jnp.linalg.eigvalsh(self.inertia)


def axisymmetric(delta: Any, dipole: Any = "transverse") -> Body:
    """The top I = diag(1, 1, 1−δ), |d| = 1, in units of I₁ and τ₀ = k d²/I₁.

    Args:
        delta: Shape parameter δ = 1 − I₃/I₁: 0 < δ < 1 prolate, 0 a sphere, −1 ≤ δ < 0 oblate, −1
            a disc. δ = 1 is a needle without inertia about its axis, which is refused.
        dipole: Direction: "transverse" (first axis), "longitudinal" (third axis, the symmetry
            axis), or a vector of shape (3,), which is divided by its length.

    Raises:
        ValueError: Unless −1 ≤ δ < 1 and the direction is one of the three kinds.

    Source: sections 3.1 (longitudinal) and 4 (transverse).

    Example:
        >>> axisymmetric(-0.5).inertia.diagonal().tolist()
        [1.0, 1.0, 1.5]
    """
    delta = finite("delta", delta)
    delta = where_valid("delta", delta, (delta >= -1) & (delta < 1), "satisfy -1 <= delta < 1")
    if not isinstance(dipole, str):
        vector = _nonzero_dipole(dipole)
        direction = vector / jnp.linalg.norm(vector, axis=-1, keepdims=True)
    elif dipole in AXES:
        direction = AXES[dipole]
    else:
        refuse("dipole", 'be "transverse", "longitudinal" or a vector', f"is {dipole!r}")
    one = jnp.ones_like(delta)
    return Body(_diagonal(one, one, 1 - delta), direction)


def spheroid(mass: Any, a: Any, c: Any, *, dipole: Any) -> Body:
    """The homogeneous spheroid I = m/5 diag(a²+c², a²+c², 2a²), symmetric about the third axis.

    Args:
        mass: Mass m, in units of M.
        a: Equatorial semi-axis, in units of ℓ.
        c: Polar semi-axis, in units of ℓ; c > a is prolate.
        dipole: Dipole moment, shape (3,), in units of √(I₁τ₀/k).

    Raises:
        ValueError: Unless `mass`, `a` and `c` are positive; as `Body` for `dipole`.

    Example:
        >>> spheroid(5.0, 1.0, 2.0, dipole=[1, 0, 0]).moments.tolist()
        [2.0, 5.0, 5.0]
    """
    mass, a, c = _same_batch(
        mass=(_positive("mass", mass), 0), a=(_positive("a", a), 0), c=(_positive("c", c), 0)
    )
    transverse = mass * (a**2 + c**2) / 5
    return Body(_diagonal(transverse, transverse, 2 * mass * a**2 / 5), dipole)


def box(mass: Any, lengths: Any, dipole: Any) -> Body:
    """The homogeneous cuboid I = m/12 diag(l₂²+l₃², l₃²+l₁², l₁²+l₂²).

    Args:
        mass: Mass m, in units of M.
        lengths: Edges l₁, l₂, l₃ along the body axes, shape (3,), in units of ℓ.
        dipole: Dipole moment, shape (3,), in units of √(I₁τ₀/k).

    Raises:
        ValueError: Unless `mass` and `lengths` are positive; as `Body` for `dipole`.

    Example:
        >>> box(12.0, [1, 2, 3], [1, 0, 0]).inertia.diagonal().tolist()
        [13.0, 10.0, 5.0]
    """
    mass, lengths = _same_batch(
        mass=(_positive("mass", mass), 0), lengths=(_positive("lengths", lengths, (3,)), 1)
    )
    x, y, z = (mass * lengths[..., axis] ** 2 / 12 for axis in range(3))
    return Body(_diagonal(y + z, z + x, x + y), dipole)


def rod(mass: Any, length: Any, radius: Any, *, dipole: Any) -> Body:
    """The homogeneous cylinder I = m/12 diag(l²+3r², l²+3r², 6r²) about the third axis.

    Args:
        mass: Mass m, in units of M.
        length: Length l, in units of ℓ.
        radius: Radius r, in units of ℓ; not 0, else there is no inertia about the axis.
        dipole: Dipole moment, shape (3,), in units of √(I₁τ₀/k).

    Raises:
        ValueError: Unless `mass`, `length` and `radius` are positive; as `Body` for `dipole`.

    Example:
        >>> rod(12.0, 2.0, 1.0, dipole=[0, 0, 1]).inertia.diagonal().tolist()
        [7.0, 7.0, 6.0]
    """
    mass, length, radius = _same_batch(
        mass=(_positive("mass", mass), 0),
        length=(_positive("length", length), 0),
        radius=(_positive("radius", radius), 0),
    )
    transverse = mass * (length**2 + 3 * radius**2) / 12
    return Body(_diagonal(transverse, transverse, mass * radius**2 / 2), dipole)


def from_charges(masses: Any, positions: Any, charges: Any) -> Body:
    """Rigidly joined point charges: I = Σ m(ρ²1 − ρρᵀ), d = Σ qρ, ρ from the centre of mass.

    The dipole of a neutral body is the same about every point. That of a charged body is not; here
    it is taken about the centre of mass, as equation (3.3) wants for rotation about it. The recoil
    of a charged centre of mass, which acts back on the rotation to order k², is left out.

    Args:
        masses: Masses, shape (n,), in units of M; none negative, not all zero.
        positions: Positions from any origin, shape (n, 3), in units of ℓ.
        charges: Charges, shape (n,), in units of √(Mτ₀/k).

    Raises:
        ValueError: If shapes disagree or a mass is negative; as `Body` for the inertia (masses on
            one line have none about it) and for a dipole of zero.

    Source: after equation (3.3), where the paper's d is to read Σ q_a ρ_a.

    Example:
        >>> ring = [[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]]
        >>> from_charges([1, 1, 1, 1], ring, [1, 0, -1, 0]).dipole.tolist()
        [2.0, 0.0, 0.0]
    """
    masses = finite("masses", masses, (-1,))
    n = masses.shape[-1]
    physical = (masses >= 0) & (jnp.sum(masses, axis=-1, keepdims=True) > 0)
    masses, positions, charges = _same_batch(
        masses=(where_valid("masses", masses, physical, "be non-negative and not all zero"), 1),
        positions=(finite("positions", positions, (n, 3)), 2),
        charges=(finite("charges", charges, (n,)), 1),
    )
    return Body(*_multipoles(masses, positions, charges))


@functools.partial(jnp.vectorize, signature="(n),(n,c),(n)->(c,c),(c)")
def _multipoles(
    masses: Float[Array, " n"], positions: Float[Array, "n 3"], charges: Float[Array, " n"]
) -> tuple[Float[Array, "3 3"], Float[Array, "3"]]:
    """Inertia tensor and dipole moment about the centre of mass."""
    # sums rather than matrix products, which accelerators round to fewer digits
    centre = jnp.sum(masses[:, None] * positions, axis=0) / jnp.sum(masses)
    rho = positions - centre[None]
    second = jnp.sum(masses[:, None, None] * (rho[:, :, None] * rho[:, None, :]), axis=0)
    dipole = jnp.sum(charges[:, None] * rho, axis=0)
    return jnp.trace(second) * jnp.eye(3) - second, dipole


def _inertia(value: Any) -> Float[Array, "*batch 3 3"]:
    """`value` if some body of positive masses can have it, made exactly symmetric."""
    inertia = finite("inertia", value, (3, 3))
    skew = jnp.abs(inertia - jnp.swapaxes(inertia, -1, -2))
    size = jnp.max(jnp.abs(inertia), axis=(-1, -2), keepdims=True)
    symmetric = skew <= _tolerance() * size
    inertia = where_valid("inertia", inertia, symmetric, "be symmetric")
    inertia = _where_moments(
        (inertia + jnp.swapaxes(inertia, -1, -2)) / 2,
        _positive_moments(inertia),
        "be positive definite (masses on one line have a principal moment of zero)",
    )
    return _where_moments(
        inertia, _triangle_inequality(inertia), "have principal moments with J1 + J2 >= J3"
    )


def _where_moments(
    inertia: Float[Array, "*batch 3 3"], valid: Bool[Array, "*batch"], must: str
) -> Float[Array, "*batch 3 3"]:
    """`where_valid`, but the refusal tells the principal moments."""
    if concrete(inertia, valid) and not np.all(valid):
        moments = np.linalg.eigvalsh(np.asarray(inertia)[~np.asarray(valid)][0])
        refuse("inertia", must, "has " + ", ".join(f"{moment:.8g}" for moment in moments))
    return where_valid("inertia", inertia, valid, must)


def _rounding() -> float:
    """What a few operations may lose, relative to the largest number among them."""
    return 16 * float(jnp.finfo(jnp.result_type(float)).eps)


def _tolerance() -> float:
    """How far off, relatively, a symmetry or an equality in the user's numbers may be."""
    return max(1e-12, _rounding())


@functools.partial(jnp.vectorize, signature="(n,n)->()")
def _positive_moments(inertia: Float[Array, "3 3"]) -> Bool[Array, ""]:
    """Whether every principal moment is positive beyond rounding."""
    return _positive_definite(inertia - _rounding() * jnp.trace(inertia) * jnp.eye(3))


@functools.partial(jnp.vectorize, signature="(n,n)->()")
def _triangle_inequality(inertia: Float[Array, "3 3"]) -> Bool[Array, ""]:
    """Whether J₁ + J₂ ≥ J₃: ½ tr(I) 1 − I = Σ mρρᵀ has no negative eigenvalue."""
    trace = jnp.trace(inertia)
    return _positive_definite((0.5 + _tolerance()) * trace * jnp.eye(3) - inertia)


def _positive_definite(m: Float[Array, "3 3"]) -> Bool[Array, ""]:
    """Whether all three pivots of Gaussian elimination are positive.

    Unlike the leading minors, the pivots feel rounding only as an error of m itself, so that a
    matrix with two eigenvalues near zero is still judged rightly.
    """
    first = m[0, 0]
    second = m[1, 1] - m[0, 1] * (m[0, 1] / first)
    mixed = m[1, 2] - m[0, 1] * (m[0, 2] / first)
    third = m[2, 2] - m[0, 2] * (m[0, 2] / first) - mixed * (mixed / second)
    return (first > 0) & (second > 0) & (third > 0)


def _nonzero_dipole(dipole: Any) -> Float[Array, "*batch 3"]:
    """`dipole` unless it is zero."""
    vector = finite("dipole", dipole, (3,))
    return where_valid("dipole", vector, jnp.any(vector != 0, axis=-1), "not be zero")


def _positive(name: str, value: Any, shape: tuple[int, ...] = ()) -> Float[Array, "..."]:
    array = finite(name, value, shape)
    return where_valid(name, array, array > 0, "be positive")


def _diagonal(*moments: Float[Array, "*batch"]) -> Float[Array, "*batch 3 3"]:
    """The inertia tensor whose principal axes are the body axes."""
    return jnp.vectorize(jnp.diag, signature="(n)->(n,n)")(jnp.stack(moments, axis=-1))


def _same_batch(**fields: tuple[Float[Array, "..."], int]) -> list[Float[Array, "..."]]:
    """The arrays, each given with its natural rank, repeated to their common batch."""
    sizes = {name: array.shape[0] for name, (array, rank) in fields.items() if array.ndim > rank}
    if not sizes:
        return [array for array, _ in fields.values()]
    first, size = next(iter(sizes.items()))
    for name in sizes:
        if sizes[name] != size:
            refuse(name, f"have the batch size {size} of `{first}`", f"has {sizes[name]}")
    return [
        array if name in sizes else jnp.broadcast_to(array, (size, *array.shape))
        for name, (array, _) in fields.items()
    ]
