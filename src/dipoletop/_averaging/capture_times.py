"""When the mean energy of a needle falls that is captured at a random phase.

A needle obeys the slow flow up to its entry into the plane, where q = 2δ|z| is still large. There
its states are the `phases`, each moved along its orbit to the same time. From then on all of them
are followed. The slow flow and their mean energy meet at the time when they are equal.

The independent variable is the share p of E − E∞ that is lost on average. So dy/dp is the ratio of
dy/dt to dp/dt, a mean over the phases, and t(p) is one more variable. The energy at a given time is
a periodic and analytic function of the phase, so few phases give its mean.
"""

import functools
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._base.chebyshev import chebyshev_sum, collocation_rule
from .._base.guards import safe_divisor
from .._base.integration import integrated
from .._base.types import Real
from .capture import LARGEST
from .motion import SlowMotion
from .planar_orbits import MAX_STEPS, PlanarMotion, entry_q, state_after
from .unfolding import phases

LANES = 64  # phases that are followed
NODES = 24  # shares p at which the time is computed
PRECISION = 1e-8  # relative tolerance of an orbit

MATCHING = 0.2  # times q: the relative error of a time after the entry, by entries at 4q
INTERPOLATION = 2e-3
"""The error of the times of thin rods over s(1 − s), with s the weight of δ = `LARGEST`."""
FOLLOWING = 2e-4  # the relative error that so few phases and nodes make


class Clock(NamedTuple):
    """The mean energy from entry on until half of E − E∞ is lost.

    With u that of entry, energies are in units of J₁u/2 and times in units of 1/u.
    """

    first: Real
    """The mean energy at entry."""
    last: Real
    """The mean energy at the end."""
    times: Float[Array, "n"]
    """The times at the `NODES`."""
    q: Real
    """The q of entry."""
    error: Real | float = 0.0
    """The error of `times` by interpolation."""

    def time(self, energy: Real) -> Real:
        """Return the time at which the mean energy has fallen to a value."""
        rule = collocation_rule(NODES).coefficients
        lost = jnp.clip((self.first - energy) / (self.first - self.last), 0.0, 0.5)
        return chebyshev_sum(jnp.asarray(rule) @ self.times, 4 * lost - 1)

    def time_at(
        self,
        motion: SlowMotion,
        energy: Real,
        error: Real,
        square: Real,
        moment: Real | float = 1.0,
    ) -> tuple[Real, Real]:
        """Return the time at which the mean energy has fallen to a value, and its relative error.

        The latter is 0 if the entry comes later: the time is then that of the slow flow.

        Args:
            motion: the slow flow before the entry; time and energy are in its units.
            energy: the value.
            error: the relative error of energies.
            square: ω⊥² at entry.
            moment: J₁.
        """
        unit = moment * square / 2
        entry = self.first * unit
        entered = energy < entry
        value = energy / safe_divisor(unit)
        passed, slope = jax.jvp(self.time, (value,), (value,))
        scale = 2 * moment / safe_divisor(square)
        time = motion.time_at(jnp.maximum(energy, entry)) + jnp.where(entered, passed * scale, 0.0)
        absolute = (self.error - slope * error) * scale
        off = MATCHING / self.q + FOLLOWING + absolute / time
        return time, jnp.where(entered, off, 0.0)


def clock_of_needle(delta: Real, last: Real) -> Clock:
    """Return the clock of a body with two equal moments, 0 < δ < 1; `last` as in `Clock`.

    Beyond `LARGEST` the times are interpolated between those there and the limit for δ → 1, where
    all orbits enter at q(1 − δ) = 1.5 `ENTRY`.
    """
    delta = jnp.where((delta > 0) & (delta < 1), delta, 0.5)
    nearest = jnp.minimum(delta, LARGEST)
    zero = jnp.zeros_like(delta)
    clock = clock_from(PlanarMotion(nearest, zero), entry_q(nearest, zero), last)
    share = (1 - delta) / (1 - nearest)
    energies = clock.first - collocation_rule(NODES).nodes / 2 * (clock.first - last)
    times, values = _of_rods()
    limit = jnp.interp(-energies, -values, times)
    both = share * clock.times + (1 - share) * limit
    return clock._replace(times=both, error=INTERPOLATION * share * (1 - share))


def clock_from(plane: PlanarMotion, q: Real, last: Real) -> Clock:
    """Return the clock of orbits that enter at a given q; `last` as in `Clock`."""
    states = _at_one_time(plane, q)
    energies = jnp.exp(states[:, 2])
    first = jnp.mean(energies)

    def field(part: Any, state: Array, args: Any) -> Array:
        y = state[:-1].reshape(LANES, 3)
        rates = jax.vmap(functools.partial(_rates, plane))(y)
        loss = -jnp.mean(jnp.exp(y[:, 2]) * rates[:, 2])
        return jnp.append(rates.ravel(), 1.0) * (first - last) / loss

    nodes = jnp.asarray(collocation_rule(NODES).nodes / 2)
    pid = diffrax.PIDController(PRECISION, PRECISION)
    start = jnp.append(states.ravel(), 0.0)
    saveat = diffrax.SaveAt(ts=nodes)
    found = integrated(field, (0.0, 0.5), start, pid, MAX_STEPS, 1e-3, saveat=saveat)
    return Clock(first, last, found.ys[:, -1], q)


def _at_one_time(plane: PlanarMotion, q: Real) -> Float[Array, "n 3"]:
    """Return the states of a random phase when the first of them passes φ = 0 at q."""
    states = phases(plane, q, LANES)
    z = q / (2 * plane.delta)

    def slope(phi: Any, y: Array, args: Any) -> Array:
        rates = _rates(plane, jnp.append(phi, y[:2]))
        return jnp.append(rates[1:], 1.0) / rates[0]

    zero = jnp.zeros_like(z)
    turn = zero, -jnp.pi * jnp.sign(plane.delta * z)
    after, _, period = state_after(slope, turn, jnp.stack([z, zero, zero]))
    passages = period * jnp.log(states[:, 1] / z) / jnp.log(after / z)

    def moved_back(state: Array, time: Real) -> Array:
        def field(part: Any, y: Array, args: Any) -> Array:
            return -time * _rates(plane, y)

        return state_after(field, (0.0, 1.0), state)

    return jax.vmap(moved_back)(states, passages)


def _rates(plane: PlanarMotion, y: Float[Array, "3"]) -> Float[Array, "3"]:
    """Return d(φ, z, ln u)/dt, where u dt = dσ."""
    return jnp.exp(y[2]) * plane(0.0, y)


@functools.cache
def _of_rods() -> tuple[np.ndarray, np.ndarray]:
    """Return the mean energy of rods, δ → 1, at many times from entry.

    Capture takes no time (`capture`), and leaves C = u(3 cos²φ − 2) constant, with a density of
    cos²φ at u = 1. So (1/u)′ = 2 sin²φ = (2/3)(1 − C/u), until cos φ = 0 at u = −C/2 if C < 0; from
    then on (1/u)′ = 2.
    """
    times = np.linspace(0.0, 4.0, 4001)[:, None]
    phi = (np.arange(2000) + 0.5) * np.pi / 4000
    weights = np.cos(phi) ** 2 / np.sum(np.cos(phi) ** 2)
    c = 3 * np.cos(phi) ** 2 - 2
    reach = np.where(c < 0, 1.5 / np.abs(c) * np.log(3 / (1 - c)), np.inf)  # 1/u = 2/|C| there
    inverse = (1 - (1 - c) * np.exp(-2 / 3 * c * np.minimum(times, reach))) / c
    inverse = inverse + 2 * np.maximum(times - reach, 0.0)
    return times[:, 0], (1 / inverse) @ weights
