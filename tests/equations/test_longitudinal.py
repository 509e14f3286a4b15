"""Longitudinal dipole: closed forms, levels, outcomes."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dipoletop as dt

RNG = np.random.default_rng(5)
B = 32
DELTAS = jnp.asarray(np.concatenate([[-1.0, 0.0], RNG.uniform(-1, 0.95, B - 2)]))
OMEGAS = jnp.asarray(RNG.normal(size=(3, B)))
BODIES = jax.vmap(lambda d: dt.axisymmetric(d, "longitudinal"), out_axes=-1)(DELTAS)


def same(found, expected, tolerance=1e-12):
    """Equal up to a part of the largest component, lane by lane."""
    size = jnp.max(jnp.abs(expected), axis=0)
    assert float(jnp.max(jnp.abs(found - expected) / size[None])) < tolerance


@pytest.mark.parametrize("order", [1, 2])
def test_closed_forms_equal_the_general_reduction(order):
    found = dt.LongitudinalReduced(DELTAS, order)(0.0, OMEGAS)
    same(found, dt.Reduced(BODIES, order)(0.0, OMEGAS))


def test_the_other_levels_equal_the_general_ones():
    same(dt.LongitudinalSemi(DELTAS)(0.0, OMEGAS), dt.SemiReduced(BODIES)(0.0, OMEGAS))
    rates = jnp.asarray(RNG.normal(size=(2, B)))
    five = dt.LongitudinalFull(DELTAS)(0.0, jnp.concatenate([OMEGAS, rates]))
    six = dt.Full(BODIES)(0.0, jnp.concatenate([OMEGAS, rates, jnp.zeros((1, B))]))
    same(five, six[:5])


def test_every_motion_ends_about_the_dipole():
    starts = np.array([[0.2, 0.1, 0.15], [0.2, 0.1, 0.0], [0.0, 0.0, -0.2], [0.0, 0.0, 0.0]])

    @eqx.filter_jit
    def verdicts(equation):
        return jax.vmap(lambda start: equation.verdict(equation.lift(start)))(jnp.asarray(starts))

    levels = [
        dt.LongitudinalReduced(0.4),
        dt.LongitudinalReduced(0.4, 2),
        dt.LongitudinalSemi(0.4),
        dt.LongitudinalFull(0.4),
    ]
    for equation in levels:
        found = verdicts(equation)
        assert found.outcome.tolist() == [1, 2, 1, 2]
        assert found.omega_inf.tolist() == starts[:, 2].tolist()
        assert np.asarray(found.stop).tolist() == [0, 1, 0, 1]
        proven = equation.level in ("semi-reduced", "reduced, order 1 (the paper's)")
        assert found.certified.tolist() == [proven] * 4


@pytest.mark.slow
def test_the_physical_branch_keeps_the_balance():
    """Along the branch E − d₁·d₂ falls by what is radiated, and ω⊥ decays as α₋ says."""
    equation = dt.LongitudinalFull(-0.5)
    start = jnp.array([1e-4, 0.0, 0.3])
    run = dt.simulate(equation, start, jnp.array([0.0, 20.0, 40.0]), rtol=1e-12, balance=True)
    assert float(jnp.max(jnp.abs(run.balance_defect))) < 1e-11
    decay, _, turn = dt.exact.longitudinal_exponents(-0.5, 0.3)
    omega = np.asarray(run.omega)
    w = omega[:, 0] + 1j * omega[:, 1]
    slope = np.log(w[2] / w[1]) / 20
    assert abs(slope.real / float(decay) - 1) < 1e-6
    assert abs(slope.imag / float(turn - 0.3) - 1) < 1e-6
