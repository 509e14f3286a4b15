"""An equation whose runs are short, for tests of what is done with their ends."""

import equinox as eqx
import jax.numpy as jnp

import dipoletop as dt
from dipoletop import Outcome, radiation
from dipoletop._base.linalg import solve


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
