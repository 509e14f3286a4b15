"""Rigid bodies with an electric dipole: inertia tensor and dipole moment in body axes.

All quantities are dimensionless with k = 1. Choose a unit of inertia I₁ and a unit of time τ₀.
Units of mass M and of length ℓ give I₁ = Mℓ². The unit of dipole moment is then √(I₁τ₀/k), the unit
of charge √(Mτ₀/k), and |d|² measures how strongly the body radiates. With I₁ the transverse moment
of an axisymmetric top and τ₀ = k d²/I₁ the dipole has length 1.
"""

import functools
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._base.checks import concrete, finite, namespace, on_device, on_host, positive, where_valid
from ._base.linalg import diagonal
from ._base.refusals import refuse
from ._base.shown import Shown

Inertia = Float[Array, "*batch 3 3"] | Float[np.ndarray, "*batch 3 3"]
AXES = {"transverse": (1.0, 0.0, 0.0), "longitudinal": (0.0, 0.0, 1.0)}
"""Named directions of the dipole; the symmetry axis is the third."""


class Body(Shown):
    """A rigid body that obeys IΩ̇ + Ω×IΩ = d × d⃛, with k = 1.

    Either argument may have one batch axis in front; the other is then repeated along it.

    Args:
        inertia: inertia tensor I in body axes, shape (3, 3), in units of I₁.
        dipole: dipole moment d in body axes, shape (3,), in units of √(I₁τ₀/k).

    Raises:
        ValueError: an `inertia` that is not symmetric and positive definite, or whose principal
            moments violate J₁ + J₂ ≥ J₃; a `dipole` of zero; values that are not finite, or have
            a wrong shape. A rod without thickness is refused, since Ω̇ needs the inverse of I.
            Traced bad values become NaN instead.

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
    """Return the top I = diag(1, 1, 1−δ), |d| = 1, in units of I₁ and τ₀ = k d²/I₁.

    Args:
        delta: shape parameter δ = 1 − I₃/I₁: 0 < δ < 1 prolate, 0 a sphere, −1 ≤ δ < 0 oblate, −1
            a disc. δ = 1 is a needle without inertia about its axis, which is refused.
        dipole: direction: "transverse" (first axis), "longitudinal" (third axis, the symmetry
            axis), or a vector of shape (3,), which is divided by its length.

    Raises:
        ValueError: δ outside [−1, 1), or a direction of another kind.

    Source: sections 3.1 (longitudinal) and 4 (transverse).

    Example:
        >>> axisymmetric(-0.5).inertia.diagonal().tolist()
        [1.0, 1.0, 1.5]
    """
    delta = on_host(finite("delta", delta))
    delta = where_valid("delta", delta, (delta >= -1) & (delta < 1), "satisfy -1 <= delta < 1")
    if not isinstance(dipole, str):
        vector = on_host(_nonzero_dipole(dipole))
        direction = vector / namespace(vector).linalg.norm(vector, axis=-1, keepdims=True)
    elif dipole in AXES:
        direction = AXES[dipole]
    else:
        refuse("dipole", 'be "transverse", "longitudinal" or a vector', f"is {dipole!r}")
    one = namespace(delta).ones_like(delta)
    return Body(diagonal(one, one, 1 - delta), direction)


def spheroid(mass: Any, a: Any, c: Any, *, dipole: Any) -> Body:
    """Return the homogeneous spheroid I = m/5 diag(a²+c², a²+c², 2a²) about the third axis.

    Args:
        mass: mass m, in units of M.
        a: equatorial semi-axis, in units of ℓ.
        c: polar semi-axis, in units of ℓ; c > a is prolate.
        dipole: dipole moment, shape (3,), in units of √(I₁τ₀/k).

    Raises:
        ValueError: `mass`, `a` or `c` not positive; a bad `dipole`, as for `Body`.

    Example:
        >>> spheroid(5.0, 1.0, 2.0, dipole=[1, 0, 0]).moments.tolist()
        [2.0, 5.0, 5.0]
    """
    mass, a, c = _positive_numbers(mass=mass, a=a, c=c)
    transverse = mass * (a**2 + c**2) / 5
    return Body(diagonal(transverse, transverse, 2 * mass * a**2 / 5), dipole)


def box(mass: Any, lengths: Any, dipole: Any) -> Body:
    """Return the homogeneous cuboid I = m/12 diag(l₂²+l₃², l₃²+l₁², l₁²+l₂²).

    Args:
        mass: mass m, in units of M.
        lengths: edges l₁, l₂, l₃ along the body axes, shape (3,), in units of ℓ.
        dipole: dipole moment, shape (3,), in units of √(I₁τ₀/k).

    Raises:
        ValueError: `mass` or `lengths` not positive; a bad `dipole`, as for `Body`.

    Example:
        >>> box(12.0, [1, 2, 3], [1, 0, 0]).inertia.diagonal().tolist()
        [13.0, 10.0, 5.0]
    """
    mass, lengths = _same_batch(
        mass=(on_host(positive("mass", mass)), 0),
        lengths=(on_host(positive("lengths", lengths, (3,))), 1),
    )
    x, y, z = (mass * lengths[..., axis] ** 2 / 12 for axis in range(3))
    return Body(diagonal(y + z, z + x, x + y), dipole)


def rod(mass: Any, length: Any, radius: Any, *, dipole: Any) -> Body:
    """Return the homogeneous cylinder I = m/12 diag(l²+3r², l²+3r², 6r²) about the third axis.

    Args:
        mass: mass m, in units of M.
        length: length l, in units of ℓ.
        radius: radius r, in units of ℓ; not 0, as the moment about the axis must not vanish.
        dipole: dipole moment, shape (3,), in units of √(I₁τ₀/k).

    Raises:
        ValueError: `mass`, `length` or `radius` not positive; a bad `dipole`, as for `Body`.

    Example:
        >>> rod(12.0, 2.0, 1.0, dipole=[0, 0, 1]).inertia.diagonal().tolist()
        [7.0, 7.0, 6.0]
    """
    mass, length, radius = _positive_numbers(mass=mass, length=length, radius=radius)
    transverse = mass * (length**2 + 3 * radius**2) / 12
    return Body(diagonal(transverse, transverse, mass * radius**2 / 2), dipole)


def from_charges(masses: Any, positions: Any, charges: Any) -> Body:
    """Return the body I = Σ m(ρ²1 − ρρᵀ), d = Σ qρ of point charges, ρ from the centre of mass.

    The charges are rigidly joined. The dipole of a neutral body is the same about every point. The
    dipole of a charged body is taken about the centre of mass, as equation (3.3) requires for
    rotation about that point. The recoil of a charged centre of mass, which acts back on the
    rotation at order k², is neglected.

    Args:
        masses: masses, shape (n,), in units of M; none negative, not all zero.
        positions: positions from any origin, shape (n, 3), in units of ℓ.
        charges: charges, shape (n,), in units of √(Mτ₀/k).

    Raises:
        ValueError: shapes that disagree, or a negative mass; a bad inertia or dipole, as for
            `Body` (masses on one line have no moment of inertia about it).

    Source: after equation (3.3), where d should read Σ q_a ρ_a in the paper.

    Example:
        >>> ring = [[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]]
        >>> from_charges([1, 1, 1, 1], ring, [1, 0, -1, 0]).dipole.tolist()
        [2.0, 0.0, 0.0]
    """
    masses = finite("masses", masses, (-1,))
    n = masses.shape[-1]
    known = on_host(masses)
    physical = (known >= 0) & (known.sum(axis=-1, keepdims=True) > 0)
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
    """Return inertia tensor and dipole moment about the centre of mass."""
    # Sums, since accelerators round matrix products to fewer digits.
    centre = jnp.sum(masses[:, None] * positions, axis=0) / jnp.sum(masses)
    rho = positions - centre[None]
    second = jnp.sum(masses[:, None, None] * (rho[:, :, None] * rho[:, None, :]), axis=0)
    dipole = jnp.sum(charges[:, None] * rho, axis=0)
    return jnp.trace(second) * jnp.eye(3) - second, dipole


def _inertia(value: Any) -> Float[Array, "*batch 3 3"]:
    """Check an inertia tensor, and return it exactly symmetric."""
    inertia = on_host(finite("inertia", value, (3, 3)))
    transposed = inertia.swapaxes(-1, -2)
    size = abs(inertia).max(axis=(-1, -2), keepdims=True)
    symmetric = abs(inertia - transposed) <= _tolerance() * size
    inertia = where_valid("inertia", inertia, symmetric, "be symmetric")
    mean = (inertia + transposed) / 2
    positive = _positive_definite(inertia - _rounding() * _isotropic(inertia))  # beyond rounding
    must = "be positive definite (masses on one line have a principal moment of zero)"
    inertia = _where_moments(mean, positive, must)
    # J₁ + J₂ ≥ J₃: ½ tr(I) 1 − I = Σ mρρᵀ has no negative eigenvalue.
    triangle = _positive_definite((0.5 + _tolerance()) * _isotropic(inertia) - inertia)
    must = "have principal moments with J1 + J2 >= J3"
    return on_device(_where_moments(inertia, triangle, must))


def _where_moments(inertia: Inertia, valid: Any, must: str) -> Inertia:
    """Return `where_valid` with a message that shows the principal moments."""
    if concrete(inertia, valid) and not np.all(valid):
        moments = np.linalg.eigvalsh(np.asarray(inertia)[~np.asarray(valid)][0])
        refuse("inertia", must, "has " + ", ".join(f"{moment:.8g}" for moment in moments))
    return where_valid("inertia", inertia, valid, must)


def _rounding() -> float:
    """Return the rounding error of a few operations, relative to the largest number among them."""
    return 16 * float(jnp.finfo(jnp.result_type(float)).eps)


def _tolerance() -> float:
    """Return the relative error that a symmetry or an equality of the user's numbers may have."""
    return max(1e-12, _rounding())


def _isotropic(inertia: Inertia) -> Any:
    """Return tensors whose three moments are the traces of others."""
    sums = inertia.trace(axis1=-2, axis2=-1)
    return diagonal(sums, sums, sums)


def _positive_definite(matrices: Any) -> Any:
    """Return whether all three pivots of Gaussian elimination are positive.

    Rounding changes the pivots like an error of the matrix itself, unlike the leading minors. The
    test is therefore also right for a matrix with two eigenvalues near zero.
    """
    m = namespace(matrices).moveaxis(matrices, (-2, -1), (0, 1))
    with np.errstate(all="ignore"):  # a pivot of 0 gives NaN, which is not positive
        first = m[0, 0]
        second = m[1, 1] - m[0, 1] * (m[0, 1] / first)
        mixed = m[1, 2] - m[0, 1] * (m[0, 2] / first)
        third = m[2, 2] - m[0, 2] * (m[0, 2] / first) - mixed * (mixed / second)
    return (first > 0) & (second > 0) & (third > 0)


def _nonzero_dipole(dipole: Any) -> Float[Array, "*batch 3"]:
    """Return a dipole moment; refuse zero."""
    vector = finite("dipole", dipole, (3,))
    return where_valid("dipole", vector, (on_host(vector) != 0).any(axis=-1), "not be zero")


def _positive_numbers(**values: Any) -> list[Any]:
    """Return positive numbers, repeated to their common batch; in NumPy if they are known."""
    return _same_batch(
        **{name: (on_host(positive(name, value)), 0) for name, value in values.items()}
    )


def _same_batch(**fields: tuple[Any, int]) -> list[Any]:
    """Return the arrays, each given with its natural rank, repeated to their common batch."""
    sizes = {name: array.shape[0] for name, (array, rank) in fields.items() if array.ndim > rank}
    if not sizes:
        return [array for array, _ in fields.values()]
    first, size = next(iter(sizes.items()))
    for name in sizes:
        if sizes[name] != size:
            refuse(name, f"have the batch size {size} of `{first}`", f"has {sizes[name]}")
    return [
        array if name in sizes else namespace(array).broadcast_to(array, (size, *array.shape))
        for name, (array, _) in fields.items()
    ]
