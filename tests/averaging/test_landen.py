"""Elliptic integrals by Landen's descent, against extended precision."""

import jax
import jax.numpy as jnp
import mpmath as mp
import pytest

from dipoletop._averaging.landen import descent, lag, mean_of_ratio, uniform_phase

descend, phase, delay, mean_of = map(jax.jit, (descent, uniform_phase, lag, mean_of_ratio))


@pytest.mark.parametrize("place", ["1e-30", "1e-5", "0.3", "0.99", "1 - 1e-12", "1 - 1e-25"])
def test_descent_gives_elliptic_integrals(place):
    with mp.workdps(60):
        near_one = place.startswith("1 - ")
        known = mp.mpf(float(place.removeprefix("1 - ")))
        m, m1 = (1 - known, known) if near_one else (known, 1 - known)
        k, other = mp.ellipk(m), mp.ellipk(m1)
        steps = descend(jnp.asarray(float(m)), jnp.asarray(float(m1)))

        def close(found, exact):
            assert abs(float(found) / exact - 1) < 4e-15

        close(steps.mean, mp.pi / 2 / k)
        close(steps.root, mp.exp(-mp.pi * other / k / 2) / mp.sqrt(m))
        close(phase(steps, jnp.asarray(2.5)), mp.pi / 2 / k * mp.ellipf(2.5, m))
        for t in map(mp.mpf, (1e-8, 0.3, 0.8)):
            s = 1 - t**2
            given = (jnp.asarray(float(v)) for v in (t, s, (1 - mp.sqrt(m1)) / s))
            exact = mp.atanh(t) - mp.pi / 2 / k * mp.ellipf(mp.asin(t), m1)
            close(delay(steps, *given), exact)
        for g in map(mp.mpf, (1e-6, 0.4, 0.9999)):
            # 1/(g cos² + sin²) is (1/g)/(1 − (1 − 1/g) sin²); the mean is q + (p − q) of its part.
            third = mp.ellippi(1 - 1 / g, m) / g / k
            part = (g * third - g) / (1 - g)  # ⟨g cn²/(g cn² + sn²)⟩
            mean = mean_of(steps, jnp.asarray(float(g)), jnp.asarray(3.0), jnp.asarray(2.0))
            close(mean, 2 + part)
