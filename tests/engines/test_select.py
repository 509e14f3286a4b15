"""Which engine takes an equation, and what is said where one cannot."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dipoletop as dt
from dipoletop._engines import select


class Growing(eqx.Module):
    """y′ = −erf(y): a function that has no vector instruction."""

    rate: jax.Array

    def __call__(self, t, y, args=None):
        return -self.rate[None] * jax.lax.erf(y)

    def lift(self, omega0):
        return omega0

    omega = lift

    def verdict(self, y):
        done = y[0] < 0.5
        return jnp.where(done, 2, 0), jnp.where(done, 0.0, jnp.nan), done


class Fading(Growing):
    """y′ = −r y, which the native engine can take."""

    def __call__(self, t, y, args=None):
        return -self.rate[None] * y


def swept(equation):
    grid = dt.Grid(w3=[0.6, 0.9])
    return dt.sweep(lambda w3: (equation(1 + w3), w3 * jnp.ones(3)), grid)


@pytest.mark.slow
def test_an_equation_without_straight_line_code_runs_in_jax_with_a_warning():
    with pytest.warns(UserWarning, match=r"The JAX engine runs, .*Growing .*operation erf"):
        found = swept(Growing)
    assert found.attrs["engine"] == "jax"
    assert np.array_equal(found.outcome, [2, 2])
    with pytest.raises(ValueError, match=r"`engine` must be 'auto' or 'jax' here, .*erf"):
        dt.classify_many(Growing(jnp.ones(3)), jnp.ones((3, 3)), engine="native")


@pytest.mark.slow
def test_without_llvmlite_jax_runs(monkeypatch):
    assert swept(Fading).attrs["engine"] == "native"
    missing = None, "llvmlite cannot be imported (gone)"
    monkeypatch.setattr(select, "_native_engine", lambda: missing)
    assert swept(Growing).attrs["engine"] == "jax"  # as above, but without a warning
    fading = Fading(jnp.ones(3))
    assert select.select_engine("auto", fading, jax.devices()[0], "value").name == "jax"
    with pytest.raises(ValueError, match=r"'native', but llvmlite cannot be imported \(gone\)"):
        dt.classify_many(fading, jnp.ones((3, 3)), engine="native")
