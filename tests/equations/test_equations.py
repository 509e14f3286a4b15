"""Equations of motion: closed forms, general forms, limits and symmetries agree."""

import itertools

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dipoletop as dt
from dipoletop import radiation

RNG = np.random.default_rng(11)
B = 64
DELTAS = jnp.asarray(np.concatenate([[-1.0, -0.5, 0.0], RNG.uniform(-1, 0.95, B - 3)]))
OMEGAS = jnp.asarray(RNG.normal(size=(3, B)))
BODIES = jax.vmap(dt.axisymmetric, out_axes=-1)(DELTAS)

FIRST_ORDER = [
    dt.TransverseReduced(-0.3),
    dt.TransverseReduced(-0.3, order=3),
    dt.TransverseSemi(-0.3),
    dt.Reduced(dt.axisymmetric(-0.3), order=2),
    dt.SemiReduced(dt.axisymmetric(-0.3)),
]


# Compiled once for each equation and shape: op by op, a general body takes a second for each start.
rate = eqx.filter_jit(lambda equation, y: equation(0.0, y))


def close(a, b, tol):
    """Largest difference over the size of the second argument, lane by lane."""
    assert float(jnp.max(jnp.abs(a - b) / jnp.max(jnp.abs(b), axis=0)[None])) < tol


@pytest.mark.parametrize("order", [1, 2, 3])
def test_closed_forms_equal_the_general_reduction(order):
    """Two independent ways to the same rates, for random states and shapes."""
    closed = dt.TransverseReduced(DELTAS, order=order)(0.0, OMEGAS)
    close(closed, dt.Reduced(BODIES, order=order)(0.0, OMEGAS), 1e-12)


def test_closed_semi_reduced_equals_the_general_one():
    close(dt.TransverseSemi(DELTAS)(0.0, OMEGAS), dt.SemiReduced(BODIES)(0.0, OMEGAS), 1e-13)


def test_closed_full_equation_equals_the_general_one():
    """Five components of the closed form against six of the general one."""
    a = jnp.asarray(RNG.normal(size=(2, B)))
    five = dt.TransverseFull(DELTAS)(0.0, jnp.concatenate([OMEGAS, a]))
    state = jnp.concatenate([OMEGAS, jnp.zeros((1, B)), a])
    six = dt.Full(BODIES)(0.0, state)
    close(five, six[jnp.array([0, 1, 2, 4, 5])], 1e-13)
    close(five[:3], dt.Full(BODIES).omega_dot(state), 1e-13)


def test_full_equation_is_the_equation_of_motion():
    """IΩ̇ + N = T with Ω̈ from the state's own rate, for a generic body (3.3)."""
    root = RNG.normal(size=(3, 3))
    inertia = root @ root.T + 3 * np.eye(3)
    body = dt.Body(inertia, RNG.normal(size=3))
    equation = dt.Full(body)
    n = body.dipole / jnp.linalg.norm(body.dipole)
    a = jnp.asarray(RNG.normal(size=3))
    y = jnp.concatenate([jnp.asarray(RNG.normal(size=3)), a - jnp.dot(a, n) * n])
    rate = equation.omega_dot(y)
    second = jax.jvp(equation.omega_dot, (y,), (equation(0.0, y),))[1]
    torque = radiation.radiation_torque(body, y[:3], rate, second)
    left = body.inertia @ rate + radiation.gyroscopic_torque(body, y[:3])
    assert float(jnp.max(jnp.abs(left - torque))) < 1e-11 * float(jnp.max(jnp.abs(torque)))


@pytest.mark.parametrize(
    ("phi", "expected"),
    [(jnp.pi / 30, [0.00913023, -0.00967855]), (jnp.pi / 3, [-0.00532417, -0.01342288])],
)
def test_orders_approach_the_slow_manifold(phi, expected):
    """(ω₂′, ω₃′) on the physical branch of the full equation, physics of section 4."""
    start = dt.cylindrical(0.2, 0.2, phi)
    errors = [
        float(
            np.max(np.abs(dt.TransverseReduced(-0.2, order=m)(0.0, start)[1:] - np.array(expected)))
        )
        for m in (1, 2, 3, 4)
    ]
    assert all(later < earlier / 2 for earlier, later in itertools.pairwise(errors))
    assert errors[-1] < 3e-4  # |ω| = 0.28


@pytest.mark.parametrize("order", [1, 2])
def test_general_body_against_finite_differences(order):
    """Order m: Ω̇ and Ω̈ in the torque of (3.3) are those of a motion of the order below.

    Below order 1 lies free rotation, (3.4).
    """
    body = dt.Body(np.diag([1.0, 1.3, 2.0]), [0.6, 0.0, 0.8])
    w = jnp.array([0.3, -0.4, 0.5])

    def lower(y):
        if order == 2:
            return rate(dt.Reduced(body), y)
        return -jnp.linalg.solve(body.inertia, radiation.gyroscopic_torque(body, y))

    h = 1e-4
    slopes = [lower(w + s * h * lower(w)) for s in (-1, 1)]
    second = (slopes[1] - slopes[0]) / (2 * h)
    free = -radiation.gyroscopic_torque(body, w)
    found = jnp.linalg.solve(
        body.inertia, free + radiation.radiation_torque(body, w, lower(w), second)
    )
    assert float(jnp.max(jnp.abs(found - rate(dt.Reduced(body, order=order), w)))) < 1e-8


@pytest.mark.parametrize("equation", FIRST_ORDER, ids=lambda e: e.level)
def test_symmetries(equation):
    """(ω₂, ω₃) → −(ω₂, ω₃) and (ω₁, ω₂) → −(ω₁, ω₂) commute with every level."""
    for signs in (jnp.array([[1.0], [-1.0], [-1.0]]), jnp.array([[-1.0], [-1.0], [1.0]])):
        image = rate(equation, signs * OMEGAS)
        assert jnp.allclose(image, signs * rate(equation, OMEGAS), rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize("equation", FIRST_ORDER, ids=lambda e: e.level)
def test_one_line_serves_one_top_and_a_block(equation):
    block = rate(equation, OMEGAS)
    each = jnp.stack([rate(equation, w) for w in OMEGAS.T], axis=-1)
    assert float(jnp.max(jnp.abs(block - each))) < 1e-13 * float(jnp.max(jnp.abs(each)))


def test_cylindrical_form_is_the_cartesian_one():
    """d(ω⊥, ω₃, φ)/dτ by the chain rule from (4.2)–(4.4)."""
    for delta, w in zip(DELTAS[:8], OMEGAS.T[:8], strict=True):
        form, flat = dt.TransverseCylindrical(delta), dt.TransverseReduced(delta)
        expected = jax.jvp(form.lift, (w,), (flat(0.0, w),))[1]
        assert jnp.allclose(form(0.0, form.lift(w)), expected, rtol=1e-12, atol=1e-13)
        assert jnp.allclose(form.omega(form.lift(w)), w, rtol=1e-14)


def test_averaged_form_is_the_mean_over_the_angle():
    """(4.13)–(4.15): a trapezoidal mean over φ is exact for these harmonics."""
    angles = jnp.linspace(0, 2 * jnp.pi, 16, endpoint=False)
    for delta in DELTAS[:8]:
        states = jnp.stack([jnp.full(16, 0.7), jnp.full(16, -0.4), angles])
        mean = jnp.mean(dt.TransverseCylindrical(delta)(0.0, states), axis=1)
        averaged = dt.TransverseAveraged(delta)(0.0, jnp.array([0.7, -0.4, 0.1]))
        assert jnp.allclose(mean, averaged, rtol=1e-13, atol=1e-15)


def test_averaged_system_has_its_exact_solution():
    """`exact.averaged`, differentiated, obeys (4.13)–(4.15)."""
    times, start = jnp.array([0.0, 3.0, 200.0]), dt.cylindrical(0.3, -0.4, 0.2)

    @jax.jit
    def solution(delta):
        return jax.jvp(lambda t: dt.exact.averaged(delta, start, t), (times,), (jnp.ones(3),))

    for delta in (-0.7, -0.3, 0.4):
        omega, rate = solution(delta)
        equation = dt.TransverseAveraged(delta)
        for w, found in zip(omega, rate, strict=True):
            y = equation.lift(w)
            expected = jax.jvp(equation.omega, (y,), (equation(0.0, y),))[1]
            assert jnp.allclose(found, expected, rtol=1e-11, atol=1e-13)


def test_linearised_form_is_the_derivative():
    """(4.22)–(4.24): the Jacobian of (4.9)–(4.11) at (w, 0, 0)."""
    w, y = 0.3, jnp.array([0.02, -0.03, 0.05])
    for delta in (-0.9, -0.5, 0.4):
        jacobian = jax.jacfwd(dt.TransverseCylindrical(delta), 1)(0.0, jnp.array([w, 0.0, 0.0]))
        assert jnp.allclose(dt.TransverseLinearised(delta, w)(0.0, y), jacobian @ y, atol=1e-16)


def test_cylindrical_start_is_exact_at_quarter_turns():
    """ω₁ = 0 exactly at φ = π/2: these planes decide outcomes."""
    assert dt.cylindrical(0.2, 0.1, jnp.pi / 2)[0] == 0
    assert dt.cylindrical(0.2, 0.1, jnp.pi)[1] == 0
    assert dt.cylindrical(0.2, 0.1, -jnp.pi / 2)[1] == -0.2
    angles = jnp.linspace(-7.0, 7.0, 101)
    flat = dt.cylindrical(0.3, 0.0, angles)
    expected = 0.3 * jnp.stack([jnp.cos(angles), jnp.sin(angles), 0 * angles])
    assert jnp.allclose(flat, expected, rtol=0, atol=1e-15)


def test_fields_are_arrays_so_that_values_compile_nothing():
    calls = []

    @eqx.filter_jit
    def rate(equation, w):
        calls.append(1)
        return equation(0.0, w)

    for delta in (-0.2, 0.1, -1):
        rate(dt.TransverseReduced(delta), OMEGAS[:, 0])
    assert len(calls) == 1


def test_an_equation_is_a_diffrax_vector_field():
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(dt.TransverseSemi(-0.2)),
        diffrax.Tsit5(),
        0.0,
        1.0,
        0.1,
        jnp.array([0.1, 0.2, 0.3]),
    )
    assert bool(jnp.all(jnp.isfinite(solution.ys)))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: dt.TransverseReduced(1.0), r"`delta` must lie in \[-1, 1\), but is 1.0"),
        (lambda: dt.TransverseSemi(-1.01), r"`delta` must lie in \[-1, 1\), but is -1.01"),
        (lambda: dt.TransverseFull(jnp.nan), r"`delta` must lie in \[-1, 1\), but is nan"),
        (lambda: dt.TransverseReduced("oblate"), "`delta` must be a real number"),
        (lambda: dt.TransverseReduced(1j), "`delta` must be a real number, but has dtype complex"),
        (lambda: dt.TransverseReduced(jnp.array([0.1, 2.0])), "but has 2"),
        (lambda: dt.TransverseReduced(0.1, order=5), "`order` must be 1, 2, 3 or 4, but is 5"),
        (lambda: dt.Reduced(dt.axisymmetric(0.1), order=0), "`order` must be 1, 2, 3 or 4"),
        (lambda: dt.Reduced(dt.axisymmetric(0.1), order=True), "but is True"),
        (lambda: dt.cylindrical("a", 0.1, 0.1), "`w_perp` must be a real number"),
    ],
)
def test_bad_input_is_refused_in_one_sentence(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_traced_bad_value_becomes_nan():
    rate = jax.jit(lambda d: dt.TransverseReduced(d)(0.0, jnp.ones(3)))(2.0)
    assert bool(jnp.all(jnp.isnan(rate[1:])))
