"""Dipole radiation of a rotating body: torque, power, and the Schott terms of the balance laws.

Components are on axis 0, in body axes; lanes (if any) are behind and broadcast. Units are those of
`Body`, with k = 1. Along every motion, whatever other torque acts, the radiation torque T obeys

    Ω·T = d/dt(d₁·d₂) − |d₂|²        T = d/dt(d×d₂) − d₁×d₂    (lab frame),

where d₁ and d₂ are the first two derivatives of the dipole in the lab frame. If no other torque
acts, E − d₁·d₂ therefore decreases at the rate |d₂|², and L − d×d₂ at the rate d₁×d₂.
"""

import numpy as np
from jaxtyping import Array, Float

from ._base.checks import instance
from ._base.linalg import cross, dot, matvec, scale
from ._base.refusals import refuse
from ._base.types import Vector
from .bodies import Body


def dipole_derivatives(body: Body, omega: Vector, omega_dot: Vector) -> tuple[Vector, Vector]:
    """Compute d₁ = Ω×d and d₂ = Ω×(Ω×d) + Ω̇×d, the lab-frame derivatives in body axes.

    Args:
        body: the body.
        omega: angular velocity Ω, shape (3, ...).
        omega_dot: its time derivative Ω̇ (the same in both frames), shape (3, ...).

    Returns:
        d₁ and d₂, each of shape (3, ...).
    """
    _check(body, omega=omega, omega_dot=omega_dot)
    first = cross(omega, body.dipole)
    return first, cross(omega, first) + cross(omega_dot, body.dipole)


def angular_momentum(body: Body, omega: Vector) -> Vector:
    """Compute L = IΩ.

    Args:
        body: the body.
        omega: angular velocity Ω, shape (3, ...).

    Returns:
        L in body axes, shape (3, ...).
    """
    _check(body, omega=omega)
    return matvec(body.inertia, omega)


def _check(body: Body, **vectors: Vector) -> None:
    """Refuse arrays without components on the leading axes, such as a batch from `jax.vmap`."""
    instance("body", body, Body)
    if body.inertia.shape[:2] != (3, 3) or body.dipole.shape[:1] != (3,):
        must = "have its components on the leading axes (`jax.vmap` takes a batch of bodies)"
        refuse("body", must, f"has an inertia of shape {body.inertia.shape}")
    for name, vector in vectors.items():
        if np.shape(vector)[:1] != (3,):
            refuse(name, "have shape (3, ...)", f"has shape {np.shape(vector)}")


def kinetic_energy(body: Body, omega: Vector) -> Float[Array, "..."]:
    """Compute E = ½ Ω·IΩ.

    Args:
        body: the body.
        omega: angular velocity Ω, shape (3, ...).

    Returns:
        E, shape (...).
    """
    return dot(omega, angular_momentum(body, omega)) / 2


def gyroscopic_torque(body: Body, omega: Vector) -> Vector:
    """Compute N = Ω×IΩ, so that the lab-frame rate of angular momentum is IΩ̇ + N.

    Args:
        body: the body.
        omega: angular velocity Ω, shape (3, ...).

    Returns:
        N in body axes, shape (3, ...).
    """
    return cross(omega, angular_momentum(body, omega))


def radiation_torque(body: Body, omega: Vector, omega_dot: Vector, omega_ddot: Vector) -> Vector:
    """Compute T = d×{ d×(Ω²Ω − Ω̈) + (d·Ω̇)Ω + 2(d·Ω)Ω̇ } = d × d⃛, the radiation torque.

    Args:
        body: the body.
        omega: angular velocity Ω, shape (3, ...).
        omega_dot: its time derivative Ω̇ in body axes, shape (3, ...).
        omega_ddot: the time derivative Ω̈ of those components, shape (3, ...).

    Returns:
        T in body axes, shape (3, ...); it has no component along d.

    Source: the right-hand side of equation (3.3).

    Example:
        The torque on a plane rotator is Ω̈ − Ω³, equation (2.2).

        >>> import jax.numpy as jnp
        >>> from dipoletop.bodies import axisymmetric
        >>> rate, zero = jnp.array([0.0, 0.0, 2.0]), jnp.zeros(3)
        >>> radiation_torque(axisymmetric(0), rate, zero, zero).tolist()
        [0.0, 0.0, -8.0]
    """
    _check(body, omega=omega, omega_dot=omega_dot, omega_ddot=omega_ddot)
    d = body.dipole
    # d⃛ by (3.3), except for terms along d
    third = (
        cross(d, scale(dot(omega, omega), omega) - omega_ddot)
        + scale(dot(d, omega_dot), omega)
        + scale(2 * dot(d, omega), omega_dot)
    )
    return cross(d, third)


def radiated_power(body: Body, omega: Vector, omega_dot: Vector) -> Float[Array, "..."]:
    """Compute |d₂|², the radiated power (Larmor's formula).

    Args:
        body: the body.
        omega: angular velocity Ω, shape (3, ...).
        omega_dot: its time derivative Ω̇, shape (3, ...).

    Returns:
        The power, shape (...).
    """
    _, second = dipole_derivatives(body, omega, omega_dot)
    return dot(second, second)


def schott_energy(body: Body, omega: Vector, omega_dot: Vector) -> Float[Array, "..."]:
    """Compute d₁·d₂, the Schott energy of the near field, with d/dt(E − d₁·d₂) = −|d₂|².

    Args:
        body: the body.
        omega: angular velocity Ω, shape (3, ...).
        omega_dot: its time derivative Ω̇, shape (3, ...).

    Returns:
        d₁·d₂, shape (...).
    """
    return dot(*dipole_derivatives(body, omega, omega_dot))


def schott_angular_momentum(body: Body, omega: Vector, omega_dot: Vector) -> Vector:
    """Compute d×d₂, the near field's part of L, with d/dt(L − d×d₂) = −d₁×d₂ in the lab frame.

    Args:
        body: the body.
        omega: angular velocity Ω, shape (3, ...).
        omega_dot: its time derivative Ω̇, shape (3, ...).

    Returns:
        d×d₂ in body axes, shape (3, ...).
    """
    _, second = dipole_derivatives(body, omega, omega_dot)
    return cross(body.dipole, second)
