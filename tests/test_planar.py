"""The small-amplitude plane against the equations in space, and its curves against scipy.

The reference field is written out anew, from section 4; its solutions are scipy's, forwards in σ.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import dipoletop as dt
from dipoletop.planar import Planar, boundary, critical_delta, saddle, wobble

TILE = 128  # starts that `classify_many` takes at once, at least
PHI = np.arange(8) * np.pi / 8
# δ = −0.2: φ*, z*, z_s(0)
KNOWN = {
    False: (0.615479708670, 2.357022603955, 4.2553355749),
    True: (0.841068670568, 2.484519975, 5.4373092663),
}
both_limits = pytest.mark.parametrize("corrected", [False, True])


def reference(delta, corrected):
    """The field of section 4, for scipy."""

    def field(_, y):
        phi, z = y
        sin, cos, sine = np.sin(phi), np.cos(phi), np.sin(2 * phi)
        rate = z * (2 * sin**2 - 1 - 3 * delta * cos**2 / (1 - delta))
        return -delta * z - sine / 2, rate - corrected * sine / (1 - delta)

    return field


def edge(system, turned=0.0):
    """z_s at PHI; in one array at order 1 and one by one otherwise, so that each compiles once."""
    phi = PHI + turned
    z = [boundary(system, x) for x in phi] if system.corrected else boundary(system, phi)
    return np.asarray(z)


def solve(field, y0, sigma, events):
    settings = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-14}
    return solve_ivp(field, (0, sigma), y0, events=events, **settings)


@pytest.mark.parametrize(
    ("equation", "corrected"),
    [
        (dt.TransverseReduced, False),
        (lambda delta: dt.TransverseReduced(delta, order=2), True),
        (dt.TransverseSemi, True),
    ],
)
def test_is_the_limit_of_the_equations_in_space(equation, corrected):
    rng = np.random.default_rng(5)
    delta, phi = jnp.asarray(rng.uniform(-0.9, 0.9, 40)), jnp.asarray(rng.uniform(0, 6.3, 40))
    z = jnp.asarray(rng.normal(size=40) * 3)
    limit = Planar(delta, corrected)(0.0, jnp.stack([phi, z]))

    @jax.jit
    def error(amplitude):
        u = amplitude**2
        w1, w2 = w = amplitude * jnp.stack([jnp.cos(phi), jnp.sin(phi)])
        p1, p2, p3 = equation(delta)(0.0, jnp.stack([w1, w2, z * u]))
        growth = 2 * (w[0] * p1 + w[1] * p2) / u
        rates = jnp.stack([(w1 * p2 - w2 * p1) / u, p3 / u - z * growth]) / u
        return jnp.max(jnp.abs(rates - limit) * (1 - delta)[None] ** 3)

    assert error(1e-5) < 1e-7
    assert 80 < error(1e-3) / error(1e-4) < 125  # O(ω²)


@both_limits
def test_field_is_the_reference(corrected):
    rng = np.random.default_rng(6)
    for delta, *y in rng.uniform(-0.9, 0.9, (5, 3)):
        np.testing.assert_allclose(
            Planar(delta, corrected)(0.0, jnp.asarray(y)),
            reference(delta, corrected)(0.0, y),
            rtol=1e-12,
            atol=1e-14,
        )


@jax.jit
def jacobians(system, points):
    each = jax.jacfwd(lambda system, y: system(0.0, y), argnums=1)
    return jax.vmap(each, in_axes=(0, 1))(system, points)


@both_limits
def test_saddle_is_where_the_field_vanishes(corrected):
    delta = jnp.array([-0.45, -0.2, -0.01, 0.3, 0.9])
    system = Planar(delta, corrected)
    fixed = saddle(system)
    point = jnp.stack([fixed.phi, fixed.z])
    assert np.all((np.asarray(fixed.phi) > 0) & (np.asarray(fixed.phi) < np.pi / 2))
    np.testing.assert_allclose(system(0.0, point), 0.0, atol=1e-13)
    jacobian = jacobians(system, point)
    for value, slope in (
        (fixed.unstable, fixed.unstable_slope),
        (fixed.stable, fixed.stable_slope),
    ):
        direction = np.stack([np.ones(5), slope], axis=-1)
        stretched = np.einsum("nij,nj->ni", jacobian, direction)
        expected = np.asarray(value)[:, None] * direction
        np.testing.assert_allclose(stretched, expected, rtol=1e-11, atol=1e-11)
    assert np.all((np.asarray(fixed.unstable) > 0) & (np.asarray(fixed.stable) < 0))


@pytest.mark.parametrize("corrected", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_known_saddle_and_boundary(corrected):
    system, (phi, z, top) = Planar(-0.2, corrected), KNOWN[corrected]
    fixed = saddle(system)
    assert fixed.phi == pytest.approx(phi, abs=1e-12)
    assert fixed.z == pytest.approx(z, abs=1e-9)
    assert edge(system)[0] == pytest.approx(top, abs=6e-11)
    assert edge(system, float(fixed.phi) - 2 * np.pi)[0] == pytest.approx(float(fixed.z), rel=1e-7)


@both_limits
def test_boundary_separates_the_fates(corrected):
    """Just above it φ runs away; just below, the motion settles at some multiple of π."""
    delta = -0.35
    field = reference(delta, corrected)
    away = lambda _, y: y[0] - 12.0  # noqa: E731
    away.terminal = True
    for phi, z in zip(PHI, edge(Planar(delta, corrected)), strict=True):
        assert solve(field, (phi, z * (1 + 2e-11)), 400, away).status == 1
        below = solve(field, (phi, z * (1 - 2e-11)), 400, away)
        assert below.status == 0
        np.testing.assert_allclose(np.sin(below.y[0, -1]), 0, atol=1e-6)


def test_boundary_in_space_tends_to_that_in_the_plane():
    """At φ = 0 and order 1, by multisection: relative differences from section 4."""
    top, delta = KNOWN[False][2], -0.2
    amplitude = np.repeat([1e-2, 1e-3], TILE // 2)
    centre, width = np.full(2, top), top * np.array([4e-3, 4e-5])
    for _ in range(2):
        steps = np.linspace(-1, 1, TILE // 2)
        z = (centre[:, None] + width[:, None] * steps).ravel()
        starts = np.stack([amplitude, 0 * z, z * amplitude**2], axis=1)
        found = dt.classify_many(dt.TransverseReduced(delta), starts, rtol=1e-11, value=False)
        stops = (found.outcome == dt.Outcome.STOP).reshape(2, -1)
        assert np.all(np.diff(stops.astype(int)) >= 0)
        last = np.argmax(stops, axis=1)
        assert np.all((last > 0) & stops[:, -1])
        spacing = 2 * width / (TILE // 2 - 1)
        centre, width = centre + width * steps[last] - spacing / 2, spacing / 2
    np.testing.assert_allclose(np.abs(centre / top - 1), [1.06e-3, 1.06e-5], rtol=5e-3)


def test_critical_shapes():
    """Values of section 4."""
    assert critical_delta() == pytest.approx(0.7532357993909, abs=1e-12)
    assert critical_delta(prolate=False) == pytest.approx(-0.85980, abs=5e-6)


EDGES = {0.76: "2.4455", 0.80: "3.0625", 0.85: "4.2868", 0.90: "6.7202"}
EDGES |= {0.95: "13.992", 0.97: "23.675", 0.99: "72.072"}


@pytest.mark.parametrize(("delta", "edge"), EDGES.items())
def test_edge_of_the_wobbling_basin(delta, edge):
    last_place = 10.0 ** -len(edge.split(".")[1])
    found = wobble(delta)
    assert found.boundary == pytest.approx(float(edge), abs=0.51 * last_place)
    assert 2 < found.z < found.boundary


@pytest.mark.parametrize("delta", [0.78, 0.9])
def test_cycle_closes(delta):
    cycle, field = wobble(delta), reference(delta, True)

    def half_turn(z):
        crossing = lambda _, y: y[0] - np.pi / 2  # noqa: E731
        crossing.direction, crossing.terminal = 1, True
        turning = lambda _, y: field(0.0, y)[0]  # noqa: E731
        turning.direction = 1
        found = solve(field, (np.pi / 2, z), 20, (crossing, turning))
        return found.t_events[0][0], -found.y_events[0][0][1], found.y_events[1][0][0]

    z = float(cycle.z)
    time, after, furthest = half_turn(z)
    assert after == pytest.approx(z, rel=1e-10)
    assert 2 * time == pytest.approx(float(cycle.period), rel=1e-9)
    assert np.pi / 2 - furthest == pytest.approx(float(cycle.swing), rel=1e-9)
    step = 1e-4
    slope = (half_turn(z + step)[1] - half_turn(z - step)[1]) / (2 * step)
    assert slope**2 == pytest.approx(float(cycle.multiplier), rel=1e-3)


@pytest.mark.slow
def test_no_cycle_is_made_up_near_the_critical_shape():
    """A cycle lies inside its basin; where Newton's method leaves that, there is no value."""
    critical = critical_delta()
    for above in (1e-9, 3e-7):
        found = wobble(critical + above)
        assert found.boundary > 2.36
        assert np.isnan(found.z) or found.z < found.boundary
        assert np.isnan([found.z, found.swing, found.period]).all() or found.period > 30


def test_cycle_of_a_thin_needle_is_harmonic():
    """η = 1 − δ → 0: e″ = −2e/η with growth 2 − 3e²/η on average, so e = √(8η/3) cos √(2/η)σ."""
    eta = 1e-3
    cycle = wobble(1 - eta)
    period = 2 * np.pi * np.sqrt(eta / 2)
    expected = [4 / np.sqrt(3), np.sqrt(8 * eta / 3), period, np.exp(-2 * period)]
    np.testing.assert_allclose(cycle[:4], expected, rtol=4 * eta)


def test_what_does_not_exist_is_nan():
    shapes = jnp.array([-1.0, -0.8, -0.5, 0.0, 0.3])
    for corrected, none in ((True, [1, 0, 0, 1, 0]), (False, [1, 1, 1, 1, 0])):
        fixed = saddle(Planar(shapes, corrected))
        np.testing.assert_array_equal(np.isnan(fixed), np.tile(none, (len(fixed), 1)))
    assert np.all(np.isnan(edge(Planar(0.3))))
    assert np.all(np.isnan(edge(Planar(-0.6, corrected=False))))
    assert np.all(np.isnan(wobble(0.7532)))


def test_labels_say_which_limit():
    assert Planar(0.1).level == "small amplitude, corrected"
    assert "order 1" in Planar(0.1, corrected=False).level
