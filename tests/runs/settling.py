"""What tests of runs share: starts, differences, and an equation whose runs are short."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import dipoletop as dt
from benchmarks.problems.random_bodies import directions
from dipoletop import Outcome, radiation
from dipoletop._base.linalg import solve

FIGURE_2A = dt.cylindrical(0.2, 0.2, jnp.pi / 30)  # the start of the paper's figure 2a


def starts(n, seed, low, high):
    """Isotropic ones, of sizes that are log-uniform."""
    rng = np.random.default_rng(seed)
    way = directions(n, rng)
    return np.exp(rng.uniform(np.log(low), np.log(high), (n, 1))) * way


def difference(function, h):
    """The slope of a function at 0, of fourth order in the step h."""
    stencil = [(-2, 1 / 12), (-1, -2 / 3), (1, 2 / 3), (2, -1 / 12)]
    return sum(c * np.asarray(function(k * h)) for k, c in stencil) / h


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
