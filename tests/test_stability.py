"""Spectra at equilibria against the roots of characteristic polynomials, to 50 digits."""

import functools

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest

import dipoletop as dt
from dipoletop.stability import equilibria, spectrum, threshold

SHAPES = [-1.0, -0.97, -0.5, -0.2, -1e-3, 0.1, 0.5, 0.9, 0.99]
SPINS = np.logspace(-12, 0, 13)
DELTA, W = (part.ravel() for part in np.meshgrid(SHAPES, SPINS, indexing="ij"))
MORE = np.linspace(-0.99, 0.99, 45)  # at w = 0.01
FAR = 1e4  # where slow and fast cannot be separated
BODIES = [(0.5, 0.8, 1.0), (0.6, 0.9, 0.7), (0.97, 1.0, 0.2), (1.0, 1.0, 0.7)]
STRENGTH = 1.5  # |d|
QUICK = {"xla_backend_optimization_level": 0}  # to compile; it runs once
EPS = float(np.finfo(float).eps)


def along(w):
    return jnp.stack([w, 0 * w, 0 * w])


@functools.partial(jax.jit, compiler_options=QUICK)
def transverse(delta, w):
    """Spectra of all levels on the residual line, and the derivative in δ of the last."""
    first_order = {
        "1": dt.TransverseReduced,
        "2": lambda d: dt.TransverseReduced(d, 2),
        "semi": dt.TransverseSemi,
    }

    def one(d, w):
        return {name: spectrum(level(d), along(w)) for name, level in first_order.items()}

    def full(d):
        return jax.vmap(lambda d, w: spectrum(dt.TransverseFull(d), along(w)))(d, w)

    found, derivative = jax.jvp(full, (delta,), (jnp.ones_like(delta),))
    return {**jax.vmap(one)(delta, w), "full": found}, derivative


@pytest.fixture(scope="module")
def line():
    delta = np.concatenate([DELTA, MORE, [0.3]])
    w = np.concatenate([W, np.full(MORE.size, 0.01), [FAR]])
    return transverse(jnp.asarray(delta), jnp.asarray(w))


@functools.partial(jax.jit, compiler_options=QUICK)
@jax.vmap
def any_body(inertia, dipole, omega):
    return spectrum(dt.Full(dt.Body(inertia, dipole)), omega)


def quartic(moments, k, w):
    """The characteristic polynomial on the line along the first axis, by falling powers."""
    j1, j2, j3, k, w = (mp.mpf(x) for x in (*moments, k, w))
    return (
        k**2,
        -k * (j2 + j3),
        j2 * j3 + 2 * k**2 * w**2,
        k * w**2 * (4 * j1 - j2 - j3),
        w**2 * (k**2 * w**2 + (j1 - j2) * (j1 - j3)),
    )


def assert_roots(found, polynomial, rtol=1e-12):
    """All the roots, each once: real and imaginary parts by themselves."""
    exact = [mp.mpc(complex(z)) for z in found]
    for i, root in enumerate(exact):
        for _ in range(2):  # Newton's method from the computed root
            value = slope = mp.mpf(0)
            for coefficient in polynomial:
                slope, value = slope * exact[i] + value, value * exact[i] + coefficient
            exact[i] -= value / slope
        assert abs(exact[i].real - root.real) <= rtol * abs(exact[i].real)
        assert abs(exact[i].imag - root.imag) <= rtol * abs(exact[i].imag) + 1e-40 * abs(root)
    product = polynomial[-1] / polynomial[0]
    assert abs(mp.fprod(exact) - product) <= 1e-25 * abs(product)
    slow, fast = np.array(found[:2]), np.array(found[2:])
    assert fast.size == 0 or np.abs(slow).max() < np.abs(fast).min()
    assert slow[0].real >= slow[1].real


def assert_equal(found, expected):
    """Real and imaginary parts, each by itself."""
    for part in (np.real, np.imag):
        np.testing.assert_allclose(part(found), part(expected), rtol=1e-12, atol=0)


def test_order_1_is_as_published(line):
    slow = line[0]["1"].slow[: DELTA.size]
    pair = np.stack([-(W**2), -(1 + 2 * DELTA) / (1 - DELTA) * W**2], axis=1)
    assert_equal(slow, np.concatenate([0 * W[:, None], -np.sort(-pair, axis=1)], axis=1))


def test_semi_reduced(line):
    # (1−δ+4w²)λ² + (2+δ)w²λ + w⁴ = 0, from the 2×2 system
    found = np.asarray(line[0]["semi"].slow[:, 1:])
    for d, w, pair in zip(DELTA, W, found, strict=False):
        with mp.workdps(50):
            d, w = mp.mpf(d), mp.mpf(w)
            assert_roots(pair, (1 - d + 4 * w**2, (2 + d) * w**2, w**4))


@pytest.mark.parametrize("name", ["2", "semi", "full"])
def test_consistent_levels_agree_at_small_amplitude(line, name):
    root = np.emath.sqrt(DELTA**2 + 8 * DELTA)
    pair = np.stack([-(2 + DELTA) + root, -(2 + DELTA) - root], axis=1)
    small = W < 2e-9
    expected = (W**2 / (2 * (1 - DELTA)))[:, None] * pair
    assert_equal(line[0][name].slow[: DELTA.size, 1:][small], expected[small])


def test_full_equation_of_the_transverse_top(line):
    found = np.asarray(line[0]["full"].eigenvalues)
    for d, w, row in zip(DELTA, W, found, strict=False):
        with mp.workdps(50):
            assert_roots(row[1:], quartic((1, 1, 1 - mp.mpf(d)), 1, w))
    np.testing.assert_array_equal(found[:-1, 0], 0)


def test_derivative_in_the_shape(line):
    # of λ⁴−(2−δ)λ³+(1−δ+2w²)λ²+(2+δ)w²λ+w⁴ = 0, implicitly
    x = np.asarray(line[0]["full"].slow[: DELTA.size, 1:])
    found = np.asarray(line[1].slow[: DELTA.size, 1:])
    d, w = DELTA[:, None], W[:, None]
    below = 4 * x**3 - 3 * (2 - d) * x**2 + 2 * (1 - d + 2 * w**2) * x + (2 + d) * w**2
    np.testing.assert_allclose(found, -(x**3 - x**2 + w**2 * x) / below, rtol=1e-11)


def test_residual_line_is_stable_for_every_shape_except_at_order_1(line):
    for name in ("semi", "full"):
        assert line[0][name].stable[DELTA.size : -1].all()
    np.testing.assert_array_equal(line[0]["2"].stable[DELTA.size : -1], MORE < 0.95)
    np.testing.assert_array_equal(line[0]["1"].stable[DELTA.size : -1], MORE > -0.5)


def test_inseparable_eigenvalues_are_not_numbers(line):
    assert np.isnan(line[0]["full"].slow[-1, 1:]).all()
    assert not line[0]["full"].stable[-1]
    assert np.isfinite(line[0]["semi"].growth[-1])


def test_growth_reactivity_and_return_time(line):
    found = line[0]["semi"]
    growths, reactivities, times = (
        np.asarray(x) for x in (found.growth, found.reactivity, found.return_time)
    )
    for i in (5, 40, 116):
        d, w = DELTA[i], W[i]
        mass = np.array([[1, 2 * w], [-2 * w, 1 - d]])
        s = np.linalg.solve(mass, [[-(w**2), -d * w], [0, -(w**2)]])
        most = np.linalg.eigvalsh((s + s.T) / 2)[-1]
        np.testing.assert_allclose(reactivities[i], most, rtol=1e-9)
        growth = np.linalg.eigvals(s).real.max()
        np.testing.assert_allclose(growths[i], growth, rtol=1e-6)
        np.testing.assert_allclose(times[i], -1 / growth, rtol=1e-6)
    assert line[0]["1"].return_time[np.flatnonzero(DELTA < -0.5)[0]] == np.inf


def cases():
    """Moments with that of the dipole's axis first, this axis, and w."""
    near = [(1.0, 1.0 + 0.0225 * k**2 / 0.3, 0.7) for k in (0.999, 1.001)]  # of the threshold
    for spin in SPINS[::2]:
        for j in BODIES:
            for axis in range(3):
                yield np.roll(j, -axis), axis, spin
    for j in near:
        yield np.array(j), 0, 0.15 / STRENGTH**2


@pytest.fixture(scope="module")
def asymmetric():
    """Spectra in body axes, in other axes, and at states that are no equilibria."""
    moments, axes, w = (np.array(part) for part in zip(*cases(), strict=True))
    inertia = np.stack([np.diag(np.roll(j, a)) for j, a in zip(moments, axes, strict=True)])
    unit = np.eye(3)[axes]
    rng = np.random.default_rng(4)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    off = np.array([[0.6, 0.8, 0.0], [0.6, 0.8, 0.0], unit[0]])
    omega = np.array([[0.0, 0.0, 0.0], [0.06, 0.08, 0.0], 0.1 * unit[0] + 1e-9 * unit[1]])
    first = np.broadcast_to(np.diag(BODIES[0]), (3, 3, 3))
    turned = turn @ inertia @ turn.T
    inertias = np.concatenate([inertia, (turned + turned.transpose(0, 2, 1)) / 2, first])
    dipoles = STRENGTH * np.concatenate([unit, unit @ turn.T, off])
    spins = np.concatenate([w[:, None] * unit, w[:, None] * unit @ turn.T, omega])
    found = any_body(inertias, dipoles, spins)
    n = len(w)
    cuts = np.split(np.arange(2 * n + 3), [n, 2 * n])
    parts = [jax.tree.map(lambda x, cut=cut: np.asarray(x)[cut], found) for cut in cuts]
    return (moments, w), parts


def test_full_equation_of_any_body(asymmetric):
    (moments, w), (found, _, _) = asymmetric
    near = np.arange(len(w)) >= len(w) - 2  # the threshold: the small root is a difference
    for j, spin, row, close in zip(moments, w, np.asarray(found.eigenvalues), near, strict=True):
        with mp.workdps(50):
            assert_roots(row[1:], quartic(j, STRENGTH**2, spin), rtol=1e-9 if close else 1e-12)


def test_stable_if_the_constant_term_is_positive(asymmetric):
    (j, w), (found, _, _) = asymmetric
    constant = (STRENGTH**2 * w) ** 2 + (j[:, 0] - j[:, 1]) * (j[:, 0] - j[:, 2])
    np.testing.assert_array_equal(found.stable, constant > 0)
    assert found.stable[-2]
    assert not found.stable[-1]


def test_decay_at_small_amplitude(asymmetric):
    # Re λ = −kw²J₁[J₁(J₂+J₃)−(J₂−J₃)²]/(2J₂²J₃²) off the middle axis
    (j, w), (found, _, _) = asymmetric
    j1, j2, j3 = j.T
    expected = -(w**2) * j1 * (j1 * (j2 + j3) - (j2 - j3) ** 2) / (2 * (j2 * j3) ** 2)
    here = (w < 2e-9) & ((j1 - j2) * (j1 - j3) > 0)
    assert here.sum() > 10
    np.testing.assert_allclose(found.growth[here], STRENGTH**2 * expected[here], rtol=1e-12)


def test_rounding_of_another_frame(asymmetric):
    (j, w), (plain, turned, _) = asymmetric
    n = len(w) - 2
    error = np.abs(turned.slow - plain.slow)[:n].max(axis=1)
    degenerate = ((j[:, 0] == j[:, 1]) | (j[:, 0] == j[:, 2]))[:n]
    assert (error <= np.where(degenerate, 4 * EPS, 30 * EPS * w[:n])).all()
    np.testing.assert_allclose(turned.fast, plain.fast, rtol=1e-12)


def test_rest_and_states_that_are_no_equilibria(asymmetric):
    _, (_, _, found) = asymmetric
    np.testing.assert_array_equal(found.slow[0], 0)
    inertia, n = np.diag(BODIES[0]), np.array([0.6, 0.8, 0.0])
    across = np.eye(3) - np.outer(n, n)
    lever = inertia @ n
    rates = across @ (inertia - np.outer(lever, lever) / (n @ lever)) @ across / STRENGTH**2
    np.testing.assert_allclose(found.fast[0], np.sort(np.linalg.eigvalsh(rates))[:0:-1], rtol=1e-13)
    assert not found.stable[0]
    assert found.return_time[0] == np.inf
    assert np.isnan(found.eigenvalues[1:]).all()


def test_equilibria():
    top = dt.Body(np.diag(BODIES[0]), [0.0, -2.0, 0.0])
    line = equilibria(dt.Full(top))
    np.testing.assert_array_equal(line.direction, [0, -1, 0])
    np.testing.assert_array_equal(line.state(0.25), [0, -0.25, 0])
    tilted = dt.Body(np.diag(BODIES[0]), [1e-11, 1.0, 0.0])
    rest = equilibria(dt.Full(tilted))
    assert np.isnan(rest.direction).all()
    assert np.isnan(rest.state(0.25)).all()
    np.testing.assert_array_equal(rest.state(0), 0)


def test_the_line_of_a_batch_is_that_of_each():
    directions = jnp.array([[1.0, 0.0, 0.0], [0.0, 0.6, 0.8]])
    found = jax.vmap(lambda d: equilibria(dt.Full(dt.Body(jnp.eye(3), 2 * d))))(directions)
    np.testing.assert_allclose(found.state(0.5), 0.5 * directions, rtol=1e-15)
    np.testing.assert_array_equal(found.state(0.0), 0 * directions)


def test_thresholds():
    assert threshold(dt.TransverseReduced, 0.01, -0.99, 0.99) == pytest.approx(-0.5, abs=1e-12)
    assert np.isnan(threshold(dt.TransverseReduced, 0.01, -0.4, 0.99))
    assert np.isnan(threshold(dt.TransverseReduced, 0.01, -0.99, -0.6))
    assert np.isnan(threshold(dt.TransverseReduced, 0.0, -0.99, 0.99))


def test_spectra_as_text():
    slow, fast = jnp.array([0, -0.01 + 0.02j, -0.01 - 0.02j]), jnp.array([1 + 0j, 1.5])
    across = jnp.array([[-0.01, 0.02], [-0.02, -0.01]])
    assert repr(dt.stability.Spectrum(slow, fast, across)).splitlines() == [
        "Spectrum(stable",
        "         slow: 0, -0.01+0.02j, -0.01-0.02j",
        "         fast: 1, 1.5",
        "         return_time=100, reactivity=-0.01)",
    ]
    many = dt.stability.Spectrum(slow[None], fast[None, :0], across[None])
    assert repr(many) == "Spectrum(slow: (1, 3), fast: (1, 0))"
