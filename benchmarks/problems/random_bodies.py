"""Random bodies and starts: the families whose labels are checked."""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import dipoletop as dt

LEVELS = {"1": 1, "2": 2, "3": 3, "4": 4, "semi": None}
FAMILIES = ("transverse", "near", "asymmetric", "generic", "oblate", "closed")


class Starts(NamedTuple):
    """One body and one angular velocity for each run."""

    inertia: np.ndarray  # (N, 3, 3)
    dipole: np.ndarray  # (N, 3)
    omega: np.ndarray  # (N, 3)


@functools.cache
def _builder(order: int | None):
    def equation(inertia, dipole):
        body = dt.Body(inertia, dipole)
        return dt.SemiReduced(body) if order is None else dt.Reduced(body, order)

    return jax.jit(jax.vmap(equation, out_axes=-1))


def equations(level: str, inertia, dipole, *, closed: bool = False):
    """Return a batch of equations, lanes last; `closed`: diag(1, 1, 1 − δ), dipole (1, 0, 0)."""
    if not closed:
        return _builder(LEVELS[level])(jnp.asarray(inertia), jnp.asarray(dipole))
    delta, order = jnp.asarray(1 - inertia[:, 2, 2]), LEVELS[level]
    return dt.TransverseSemi(delta) if order is None else dt.TransverseReduced(delta, order)


def directions(n: int, rng: np.random.Generator) -> np.ndarray:
    """Isotropic unit vectors, shape (n, 3)."""
    ways = rng.normal(size=(n, 3))
    return ways / np.linalg.norm(ways, axis=1)[:, None]


def moments(rng, n: int) -> np.ndarray:
    """Return possible principal moments, uniform in the triangle J₁+J₂+J₃ = 2; shape (n, 3)."""
    return 1 - rng.dirichlet(np.ones(3), n)  # from the moments of second order ⟨x_i²⟩ > 0


def random_rotations(rng, n: int) -> np.ndarray:
    """Return random rotation matrices, shape (n, 3, 3)."""
    q, r = np.linalg.qr(rng.normal(size=(n, 3, 3)))
    q = q * np.sign(np.diagonal(r, axis1=1, axis2=2))[:, None, :]
    q[:, :, 0] *= np.linalg.det(q)[:, None]
    return q


def starts(family: str, level: str, n: int, seed: int | tuple[int, int] = 0) -> Starts:
    """Return random bodies of one family, each with an isotropic start.

    Amplitudes |d|²|Ω|√tr(I⁻²) are log-uniform from 0.01 to 1, but only up to 0.2 for orders 2 and
    higher, which diverge at larger ones.
    """
    rng = np.random.default_rng([*np.atleast_1d(seed), FAMILIES.index(family)])
    axis = np.eye(3)[rng.integers(0, 3, n)]
    j = moments(rng, n)
    rotation = random_rotations(rng, n)
    if family in ("closed", "transverse"):
        axis = np.eye(3)[np.zeros(n, int)]
        j = np.stack([np.ones(n), np.ones(n), 1 - rng.uniform(-0.98, 0.98, n)], axis=1)
    elif family == "near":
        delta, split = rng.uniform(-0.98, 0.98, n), 10 ** rng.uniform(-6, -1, n)
        axis = np.eye(3)[np.zeros(n, int)]
        j = np.stack([np.ones(n), 1 + rng.choice([-1, 1], n) * split, 1 - delta], axis=1)
        j[:, 2] = np.clip(j[:, 2], np.abs(j[:, 1] - 1) * 1.01, (1 + j[:, 1]) * 0.999)
    elif family == "oblate":  # dipole on the axis of the smallest moment: both outcomes occur
        axis = np.eye(3)[np.zeros(n, int)]
        low = rng.uniform(0.41, 0.59, n)
        least = np.maximum(low, 1 - low) + 0.001
        j = np.stack([low, least + rng.uniform(0, 1, n) * (0.605 - least), np.ones(n)], axis=1)
    elif family == "generic":
        axis = rng.normal(size=(n, 3))
    if family == "closed":
        rotation = np.broadcast_to(np.eye(3), rotation.shape)
    else:
        axis = axis * (10 ** rng.uniform(-0.3, 0.3, n) / np.linalg.norm(axis, axis=1))[:, None]
    reach = np.sum(axis**2, axis=1) * np.sqrt(np.sum(1 / j**2, axis=1))
    top = 1.0 if level in ("1", "semi") else 0.2
    speed = 10 ** rng.uniform(-2, np.log10(top), n) / reach
    omega = speed[:, None] * directions(n, rng)
    inertia = np.einsum("nij,nj,nkj->nik", rotation, j, rotation)
    inertia = (inertia + inertia.transpose(0, 2, 1)) / 2
    dipole, omega = np.einsum("nij,knj->kni", rotation, np.stack([axis, omega]))
    return Starts(inertia, dipole, omega)
