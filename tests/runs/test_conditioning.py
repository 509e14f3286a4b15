"""ω∞ and its estimated error, held to an integrator that shares nothing with the library.

The values are those of `benchmarks.accuracy.taylor_truth.Truth`: heyoka's Taylor method in long
double, with units that follow the motion.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dipoletop as dt
from dipoletop._base.types import Outcome
from dipoletop._runs.conditioning import vicinity
from dipoletop.equations._common import omega_scale_of

TRUTH = [
    (
        "order-1",
        0.05,
        (0.0075448639831482275, 0.030977464484466803, -0.29830097505973624),
        -3.0960054153299601e-15,
    ),
    ("order-1", -0.3, (0.25, 0.12, 0.05), 2.1460229648056200e-01),
    ("order-1", 0.1, (0.02, 0.03, 0.28), 7.1068957777967480e-06),
    ("order-1", 0.3, (-0.004, 0.01, 0.027), 1.4183107246440512e-04),
    ("order-1", 0.81, (0.01, -0.02, 0.3), 6.2277358101532638e-03),
    ("order-1", 0.97, (0.3, 0.8, -0.5), 2.6609279377080062e-01),
    ("semi", -0.9, (0.28, 0.05, 0.02), 2.6407263806130186e-01),
    ("semi", -0.2, (0.2, 0.1, -0.1), 1.9987950186204739e-01),
    ("semi", 0.05, (0.01, -0.04, 0.29), -9.9299746941081269e-15),
    ("semi", 0.3, (0.004, 0.01, 0.027), -1.4031618882459565e-04),
    ("semi", 0.6, (-0.1, 0.2, 0.2), 9.9375527536465196e-02),
    ("semi", 0.9, (0.2, 0.01, 0.1), 2.0155461937164281e-01),
]
TRUSTED = 3.0  # an error may exceed its estimate by this factor


def of_level(level):
    """Shapes, starts and values of a level."""
    rows = [row[1:] for row in TRUTH if row[0] == level]
    deltas, starts, values = zip(*rows, strict=True)
    return jnp.asarray(deltas), jnp.asarray(starts), np.asarray(values)


@pytest.mark.parametrize(
    ("level", "engine"),
    [
        ("order-1", "native"),
        ("semi", "native"),
        pytest.param("semi", "jax", marks=pytest.mark.slow),
    ],
)
def test_values_of_many_are_as_exact_as_they_say(level, engine):
    deltas, starts, exact = of_level(level)
    for rtol, largest in ((1e-8, 2e-3), (1e-11, 4e-6)):
        found = dt.classify_many(dt.equation_at(level, deltas), starts, rtol=rtol, engine=engine)
        assert np.all(found.outcome == Outcome.RESIDUAL)
        assert np.all(np.abs(found.omega_inf - exact) <= TRUSTED * found.omega_inf_error)
        assert np.all(found.omega_inf_error <= largest * np.abs(exact))


def test_neighbours_lie_across_the_flow():
    """Two unit vectors in units of the scales, at right angles to the rate and to each other."""
    starts = jnp.asarray(np.random.default_rng(8).normal(size=(3, 20)))
    body = dt.Body([[1.0, 0.1, 0], [0.1, 1.3, 0], [0, 0, 1.8]], [0.5, 0, 0.8])
    lanes = jax.tree.map(lambda x: jnp.broadcast_to(x[..., None], (*x.shape, 20)), body)
    for equation in (dt.TransverseSemi(jnp.full(20, 0.3)), dt.SemiReduced(lanes)):
        scales = np.asarray(omega_scale_of(equation)(starts))
        rate = np.asarray(equation(jnp.zeros(20), starts, None)) / scales
        first, second = np.asarray(vicinity(equation, starts).directions) / scales
        for one in (first, second):
            np.testing.assert_allclose(np.sum(one**2, axis=0), 1, rtol=1e-12)
            off = np.abs(np.sum(one * rate, axis=0)) / np.linalg.norm(rate, axis=0)
            assert np.all(off < 1e-12)
        assert np.all(np.abs(np.sum(first * second, axis=0)) < 1e-12)


@pytest.mark.slow
def test_values_of_bodies_are_as_exact_as_they_say():
    """Against a far smaller tolerance; of many of them the gradient is bounded, not computed."""
    rng = np.random.default_rng(5)
    moments = jnp.asarray(1 - rng.dirichlet(np.ones(3), 300))
    starts = rng.normal(size=(300, 3))
    dipole = jnp.array([1.0, 0.0, 0.0])
    bodies = dt.SemiReduced(jax.vmap(lambda j: dt.Body(jnp.diag(j), dipole))(moments))
    limits = {"slow_flow": False, "max_steps": 3000}
    found = dt.classify_many(bodies, starts, **limits)
    exact = dt.classify_many(bodies, starts, rtol=1e-12, value="unchecked", **limits).omega_inf
    known = np.isfinite(found.omega_inf) & np.isfinite(exact) & (found.steps > 0)
    assert np.sum(known & (found.steps < 20)) > 20
    assert np.sum(known & (found.steps > 50)) > 50
    off = np.abs(found.omega_inf - exact)[known]
    assert np.all(off <= TRUSTED * found.omega_inf_error[known])
    assert np.mean(found.omega_inf_error[known] < 1e-6 * np.abs(exact[known])) > 0.5


@pytest.mark.slow
def test_values_of_one_are_as_exact_as_they_say():
    deltas, starts, exact = of_level("semi")

    @jax.jit
    def found(delta, start):
        top = dt.TransverseSemi(delta)
        return dt.classify(top, start), dt.residual_rotation(top, start, rtol=1e-11)

    many = dt.classify_many(dt.TransverseSemi(deltas), starts).omega_inf_error
    for delta, start, value, other in zip(deltas, starts, exact, many, strict=True):
        one, rotation = found(delta, start)
        assert other / 10 < float(one.omega_inf_error) < 100 * other
        assert abs(float(one.omega_inf) - value) <= TRUSTED * float(one.omega_inf_error)
        assert float(one.omega_inf_error) <= 1e-3 * abs(value)
        assert float(rotation) == pytest.approx(value, rel=1e-7)


@pytest.mark.slow
def test_a_value_beside_a_derivative_is_that_value():
    level, delta, start, value = TRUTH[0]

    def rotation(delta):
        return dt.residual_rotation(dt.equation_at(level, delta), jnp.array(start))

    value_and_slope = jax.value_and_grad(rotation)(delta)
    assert float(value_and_slope[0]) == pytest.approx(value, rel=1e-6)


@pytest.fixture(scope="module")
def sign_change():
    """The φ at which ω∞ of a start passes 0, to rounding, and the problem."""

    def problem(phi):
        return dt.TransverseReduced(0.3), dt.cylindrical(0.1, 0.2, phi)

    phi = jnp.linspace(0, jnp.pi, 60)
    signs = np.sign(dt.sweep(problem, dt.Points(phi=phi)).omega_inf)
    k = int(np.flatnonzero(signs[1:] * signs[:-1] < 0)[0])
    found = dt.boundary.bisect(problem, {"phi": phi[k : k + 1]}, {"phi": phi[k + 1 : k + 2]})
    return problem, float(found.at(found.s)["phi"][0])


@pytest.mark.slow
def test_a_sign_that_is_not_certain_is_not_given(sign_change):
    problem, phi = sign_change
    beside = phi + np.array([-1e-4, -1e-12, 0.0, 1e-12, 1e-4])
    found = dt.sweep(problem, dt.Points(phi=beside))
    assert np.all(found.outcome == Outcome.RESIDUAL)
    np.testing.assert_array_equal(np.isnan(found.omega_inf), [False, True, True, True, False])
    assert found.omega_inf[0] * found.omega_inf[-1] < 0
    unchecked = dt.sweep(problem, dt.Points(phi=beside), value="unchecked")
    assert np.all(np.isfinite(unchecked.omega_inf))
    assert np.all(unchecked.omega_inf_error == np.inf)
    top, start = problem(jnp.asarray(phi))
    assert int(dt.classify(top, start).outcome) == Outcome.RESIDUAL
    assert np.isnan(dt.classify(top, start).omega_inf)
    assert np.isnan(dt.residual_rotation(top, start, rtol=1e-8))
    value, _ = jax.value_and_grad(lambda w: dt.residual_rotation(top, w, rtol=1e-8))(start)
    assert np.isnan(value)


def test_what_needs_no_estimate_has_none():
    """Exact values, stops, labels, and an absolute tolerance, which makes errors larger."""
    starts = jnp.array([[0.2, 0.1, 0.0], [0.0, 0.2, 0.0], [0.1, 0.1, 0.9], [0.2, 0.1, 0.1]])
    top = dt.TransverseReduced(-0.2)
    found, labels = dt.classify_many(top, starts), dt.classify_many(top, starts, value=False)
    coarse = dt.classify_many(top, starts, atol=1e-6)
    np.testing.assert_array_equal(found.omega_inf_error[:3], 0.0)  # ω₃ = 0 keeps ω₁; stops
    np.testing.assert_array_equal(labels.outcome, found.outcome)
    assert labels.omega_inf[0] == found.omega_inf[0]
    assert np.isnan(labels.omega_inf[3])
    assert coarse.omega_inf_error[3] > 50 * found.omega_inf_error[3]
    assert abs(coarse.omega_inf[3] - found.omega_inf[3]) <= TRUSTED * coarse.omega_inf_error[3]
