"""What equations of a user's own have in common that have a physical branch."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import dipoletop as dt
from dipoletop import Outcome


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
