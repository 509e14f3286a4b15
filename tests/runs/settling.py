"""What tests of runs share: random starts, and an equation whose runs are short."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import dipoletop as dt
from dipoletop import Outcome, radiation
from dipoletop._base.linalg import solve


def starts(n, seed, low, high):
    """Isotropic ones, of sizes that are log-uniform."""
    rng = np.random.default_rng(seed)
    way = rng.normal(size=(n, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    return np.exp(rng.uniform(np.log(low), np.log(high), (n, 1))) * way


class Settling(eqx.Module):
    """IΩ̇ = −Ω for any body, which ends where the energy says; short, so that it compiles fast."""

    body: dt.Body

    def __call__(self, t, y, args=None):
        return -solve(self.body.inertia, y)

    def lift(self, omega0):
        return omega0

    omega = lift

    def verdict(self, y):
        done = radiation.kinetic_energy(self.body, y) < 1e-3
        return jnp.where(done, int(Outcome.RESIDUAL), 0), y[0], done
