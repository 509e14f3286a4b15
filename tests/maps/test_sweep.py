"""Sweeps: agreement with `classify` and an independent integrator, known shares, refusals."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import ode

import dipoletop as dt
from dipoletop import Outcome


def reduced(w3, phi, delta=-0.2):
    return dt.TransverseReduced(delta), dt.cylindrical(0.2, w3, phi)


GRID = dt.Grid(w3=np.linspace(0.0, 0.45, 10), phi=np.linspace(0.0, 3.0, 26))


@pytest.mark.slow
@pytest.mark.parametrize("level", [dt.TransverseReduced, dt.TransverseSemi])
def test_labels_equal_classify_point_by_point(level):
    def problem(w3, phi):
        return level(-0.2), dt.cylindrical(0.2, w3, phi)

    found = dt.sweep(problem, GRID)
    assert found.shape == (10, 26)
    w3, phi = np.meshgrid(*GRID.axes.values(), indexing="ij")
    one = jax.lax.map(lambda at: dt.classify(*problem(*at)), (w3.ravel(), phi.ravel()))
    for name in ("outcome", "certified", "stop"):
        assert np.array_equal(found.column(name).ravel(), getattr(one, name))
    assert np.max(np.abs(found.omega_inf.ravel() - one.omega_inf)) < 1e-8


def _first_order(_, w, d):
    """(4.2)–(4.4) typed again."""
    w1, w2, w3 = w.tolist()
    s = w1**2 + w2**2 + w3**2
    return [
        d * w2 * w3,
        -d * w1 * w3 - (s + d * (1 + d) * w3**2) * w2,
        -(s + d * (2 * w1**2 - w2**2)) * w3 / (1 - d),
    ]


def _semi_reduced(_, w, d):
    """ω₂′ + 2ω₁ω₃′ = r₂ and (1−δ)ω₃′ − 2ω₁ω₂′ = r₃, with ω₂′ eliminated."""
    w1, w2, w3 = w.tolist()
    s = w1**2 + w2**2 + w3**2
    r2 = -d * w1 * w3 - s * w2 - d * (1 + d) * w2 * w3**2
    r3 = -s * w3 + d * w2**2 * w3
    p3 = (r3 + 2 * w1 * r2) / (1 - d + 4 * w1**2)
    return [d * w2 * w3, r2 - 2 * w1 * p3, p3]


@pytest.mark.parametrize(
    ("level", "rate"),
    [
        pytest.param(dt.TransverseReduced, _first_order, marks=pytest.mark.slow),
        (dt.TransverseSemi, _semi_reduced),
    ],
)
def test_labels_equal_an_independent_integrator_on_500_points(level, rate):
    """scipy's DOP853 at 1e-12, run until rotation or the residual line has plainly won."""

    def shape(w3, phi, delta):
        return level(delta), dt.cylindrical(0.2, w3, phi)

    def draw(key):
        a, b, c = jax.random.split(key, 3)
        return {
            "w3": jax.random.uniform(a, (), float, 0.02, 0.5),
            "phi": jax.random.uniform(b, (), float, 0, jnp.pi),
            "delta": jax.random.uniform(c, (), float, -0.45, -0.15),
        }

    sample = dt.Sample(n=500, seed=4, draw=draw)
    found = dt.sweep(shape, sample, value=False)
    points = jax.tree.map(np.asarray, sample.points(np.arange(500)))
    for i in range(500):
        w3, phi, d = (float(points[name][i]) for name in ("w3", "phi", "delta"))
        start = [0.2 * np.cos(phi), 0.2 * np.sin(phi), w3]
        assert found.outcome[i] == _destiny(rate, d, start), (d, start)


def _destiny(rate, d, start):
    """No certificate: the line is all but reached, or precession is far ahead of braking."""
    seen = []

    def look(_, w):
        if abs(d * w[2]) > 6 * (w[0] ** 2 + w[1] ** 2):
            seen.append(Outcome.STOP)
        elif (w[0] * w[1]) ** 2 + (d * w[2]) ** 2 < 1e-4 * w[0] ** 4:
            seen.append(Outcome.RESIDUAL)
        return -1 if seen else 0  # -1 ends the run

    # The compiled DOP853; that of `solve_ivp` is Python, and many times slower.
    run = ode(lambda t, w: rate(t, w, d)).set_integrator(
        "dop853", rtol=1e-12, atol=1e-16, nsteps=100_000
    )
    run.set_solout(look)
    run.set_initial_value(start)
    run.integrate(1e12)
    assert seen, "no decision by τ = 1e12"
    return seen[0]


@pytest.mark.parametrize(
    ("level", "amplitude", "delta", "expected", "error"),
    [
        # 200 000 starts each, with their standard errors
        (dt.TransverseReduced, 0.2, -0.4, 0.1402, 0.0008),
        (dt.TransverseReduced, 0.2, -0.2, 0.5197, 0.0011),
        (dt.TransverseReduced, 0.2, -0.1, 0.7755, 0.0009),
        (dt.TransverseReduced, 0.2, -0.05, 0.8972, 0.0007),
        # 20 000 starts each
        (dt.TransverseSemi, 0.2, -0.9, 0.0675, 0.0018),
        (dt.TransverseSemi, 0.2, -0.5, 0.2096, 0.0029),
        (dt.TransverseSemi, 0.2, -0.3, 0.4154, 0.0035),
        (dt.TransverseSemi, 0.2, -0.1, 0.7973, 0.0028),
        (dt.TransverseSemi, 1.0, -0.9, 0.3556, 0.0034),
        (dt.TransverseSemi, 1.0, -0.2, 0.8937, 0.0022),
        (dt.TransverseSemi, 0.01, -0.9, 0.0036, 0.0005),
        (dt.TransverseSemi, 0.2, -0.2, 0.5894, 0.0035),
        (dt.TransverseSemi, 1.0, -0.5, 0.6541, 0.0034),
        (dt.TransverseSemi, 0.01, -0.2, 0.0437, 0.0014),
    ],
)
def test_residual_fractions(level, amplitude, delta, expected, error):
    """Isotropic starts, N = 20 000: within four standard errors of both samples."""
    n = 20_000
    sample = dt.Sample(n=n, amplitude=amplitude, seed=1)
    found = dt.sweep(lambda w: (level(delta), w), sample, value=False)
    share = found.fractions()["RESIDUAL"].share
    both = np.hypot(error, np.sqrt(expected * (1 - expected) / n))
    assert abs(share - expected) < 4 * both
    assert found.fractions().keys() <= {"RESIDUAL", "STOP"}


@pytest.mark.parametrize(
    ("delta", "expected"), [(-0.9, 0.0675), (-0.5, 0.2096), (-0.3, 0.1139), (-0.2, 0.0629)]
)
def test_share_of_starts_that_end_differently_at_the_two_levels(delta, expected):
    sample = dt.Sample(n=20_000, amplitude=0.2, seed=1)
    first, semi = (
        dt.sweep(lambda w, level=level: (level(delta), w), sample, value=False)
        for level in (dt.TransverseReduced, dt.TransverseSemi)
    )
    assert abs(np.mean(first.outcome != semi.outcome) - expected) < 0.01


def test_axes_of_any_kind():
    """Shapes, amplitudes and directions as axes; a single number is an axis of length 1."""
    ways = np.array([[1.0, 0.2, 0.1], [0.1, 0.2, 1.0]])

    def problem(delta, size, way):
        return dt.TransverseSemi(delta), size * way

    grid = dt.Grid(delta=-0.3, size=[0.1, 0.3], way=ways)
    found = dt.sweep(problem, grid)
    assert found.shape == (1, 2, 2)
    for i, size in enumerate([0.1, 0.3]):
        for j, way in enumerate(ways):
            one = dt.classify(dt.TransverseSemi(-0.3), size * way)
            assert int(found.outcome[0, i, j]) == int(one.outcome)


def test_bad_points_are_failed_lanes():
    found = dt.sweep(reduced, dt.Grid(delta=[-0.2, 1.0, -3.0], w3=0.2, phi=[0.1, 1.0]))
    assert np.all(found.outcome[1:] == Outcome.FAILED)
    assert np.all(np.isnan(found.omega_inf[1:]))
    assert found.outcome[0, 0, 0] == Outcome.RESIDUAL


def test_confirmation_at_a_second_tolerance():
    found = dt.sweep(reduced, GRID, rtol=1e-4, confirm=1e-9)
    exact = dt.sweep(reduced, GRID, rtol=1e-9)
    assert np.array_equal(found.changed, found.outcome != exact.outcome)
    # Nearer to the boundary than the tolerance, a start can carry either label.
    low, high = 0.1, 1.0
    for _ in range(3):
        line = dt.sweep(reduced, dt.Grid(w3=0.2, phi=np.linspace(low, high, 128)), rtol=1e-11)
        last = int(np.flatnonzero(np.diff(line.outcome[0]))[0])
        low, high = line.coords["phi"][last : last + 2]
    near = dt.Grid(w3=0.2, phi=np.linspace(low, high, 128))
    assert dt.sweep(reduced, near, rtol=1e-3, confirm=1e-11).changed.any()
    assert not dt.sweep(reduced, near, rtol=1e-11, confirm=1e-12).changed.any()


@pytest.mark.parametrize("devices", ["gpu", [], ["cpu"]])
def test_devices_are_those_of_jax(devices):
    with pytest.raises(ValueError, match="`devices` must list at least one of JAX's devices, as"):
        dt.sweep(reduced, GRID, devices=devices)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: dt.sweep(reduced, dt.Grid(w3=[0.1], theta=[0.2])),
            r"`over` must name the arguments of `problem` .* but has w3, theta",
        ),
        (lambda: dt.sweep(lambda w: w, dt.Sample(n=5)), "`problem` must return .equation, omega0."),
        (
            lambda: dt.sweep(lambda w: (dt.TransverseReduced(0.1), w[:2]), dt.Sample(n=5)),
            r"`omega0 of problem` must have shape \(3,\), but has shape \(2,\)",
        ),
        (
            lambda: dt.sweep(lambda w: (dt.TransverseAveraged(0.1), w), dt.Sample(n=5)),
            "`equation` must have a method",
        ),
        (lambda: dt.sweep(reduced, GRID, confirm=1e-20), "`confirm` must lie between"),
    ],
)
def test_bad_input_is_refused_in_one_sentence(call, message):
    with pytest.raises(ValueError, match=message):
        call()
