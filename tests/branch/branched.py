"""Motions along the branch that several tests follow, and equations of a user's own with one."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import dipoletop as dt
from dipoletop import Outcome

TOP = dt.TransverseFull(-0.2)
STARTS = {phi: dt.cylindrical(0.2, 0.2, phi) for phi in (np.pi / 30, np.pi / 3)}
"""The two starts of figure 2, of which the second one stops."""


def isotropic(seed, size, count=48):
    """Starts of all directions."""
    ways = np.random.default_rng(seed).normal(size=(count, 3))
    return size * ways / np.linalg.norm(ways, axis=1, keepdims=True)


class Branched(eqx.Module):
    """A sphere with the state (ω, ω̇), which is at rest where ω is small."""

    @property
    def runaway_rate(self):
        return jnp.ones(())

    @property
    def body(self):
        return dt.Body(np.eye(3), [1.0, 0.0, 0.0])

    def fast(self, rate):
        return rate

    def lift(self, omega):
        return jnp.concatenate([omega, self.semi(0.0, omega)])

    def omega(self, y):
        return y[:3]

    def verdict(self, y):
        slow = jnp.sum(y[:3] ** 2) < self.rest**2
        return jnp.where(slow, int(Outcome.STOP), 0), jnp.zeros(()), slow & False
