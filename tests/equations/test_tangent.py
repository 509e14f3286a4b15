"""First variations: the two ways to batch them agree, and absent members are absent."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import dipoletop as dt
from dipoletop.equations._common import is_full, physical
from dipoletop.equations.levels import level_of
from dipoletop.equations.tangent import Tangent

OMEGA = jnp.array([0.2, 0.1, -0.3])


def tangent(equation, **options):
    """With the variations by each parameter and each component of ω₀."""
    leaves, structure = jax.tree.flatten(equation)
    n = len(leaves)
    units = jnp.eye(n + 3)
    parameters = jax.tree.unflatten(structure, [units[:, k] for k in range(n)])
    return Tangent(equation, parameters, units[:, n:], jnp.linalg.norm(OMEGA), **options)


rates_of = eqx.filter_jit(lambda varied, omega: varied(0.0, varied.lift(omega)))


def test_variations_are_the_derivatives_of_the_rates():
    """With both batchings, against forward derivatives of the rates by δ and by ω₀."""
    equation = dt.TransverseSemi(-0.3)

    def rates(x):
        return dt.TransverseSemi(x[0])(0.0, x[1:])

    exact = jax.jit(jax.jacfwd(rates))(jnp.append(-0.3, OMEGA))
    for basis in (False, True):
        varied = tangent(equation, basis=basis)
        rate, *variations = rates_of(varied, OMEGA).reshape(5, 3)
        np.testing.assert_allclose(rate, equation(0.0, OMEGA), rtol=1e-14)
        np.testing.assert_allclose(jnp.stack(variations, axis=1), exact, rtol=1e-12, atol=1e-15)


def test_terms_of_what_does_not_vary_are_left_out():
    """δ varies along the first variation only; the others get by with fewer operations."""
    equation = dt.TransverseReduced(-0.3, order=2)
    point = equation.lift(OMEGA)
    for basis, varying in ((False, ((True,), *((False,),) * 3)), (True, ((True,),) * 4)):
        every = tangent(equation, basis=basis)
        some = tangent(equation, basis=basis, varying=varying)
        np.testing.assert_allclose(rates_of(some, OMEGA), rates_of(every, OMEGA), rtol=1e-14)

    def operations(**options):
        start_only = Tangent(equation, jax.tree.map(lambda _: jnp.zeros(1), equation), **options)
        state = jnp.concatenate([point, point])
        return len(jax.make_jaxpr(lambda y: start_only(0.0, y))(state).eqns)

    given = {"start_variations": OMEGA[None], "start_size": jnp.ones(())}
    assert operations(varying=((False,),), **given) < 0.95 * operations(**given)


def test_slack_widens_the_errors_of_variations_only():
    y = tangent(dt.TransverseReduced(-0.3)).lift(OMEGA)
    tight, loose = (
        tangent(dt.TransverseReduced(-0.3), tangent_slack=slack).error_scale(y)
        for slack in (3.0, 6.0)
    )
    np.testing.assert_array_equal(tight[:3], loose[:3])
    np.testing.assert_allclose(loose[6:], 2 * tight[6:], rtol=1e-14)


class Nameless(eqx.Module):
    """Without any optional member."""

    rate: jax.Array = eqx.field(converter=jnp.asarray)

    def __call__(self, t, y, args=None):
        return -self.rate * y

    def lift(self, omega0):
        return omega0

    def omega(self, y):
        return y

    def verdict(self, y):
        return jnp.asarray(0), jnp.zeros(()), jnp.asarray(False)


def test_what_the_equation_has_not_the_tangent_has_not():
    bare, full = tangent(Nameless(1.0)), tangent(dt.TransverseFull(-0.3))
    assert (bare.runaway_rate, bare.body, level_of(bare)) == (None, None, "Nameless")
    assert not is_full(bare)
    assert is_full(full)
    assert level_of(full) == "full"
    assert physical(dt.RotatorFull()) == dt.RotatorBranch()
