"""Every region that decides, at its border: formulas written out once more, in NumPy.

Points just inside must be decided as the formula says, points just outside must not be.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dipoletop as dt
from dipoletop import Outcome, Stop
from dipoletop.equations._common import planar_rates

N = 128  # points on every border, so that each level compiles once
NEAR = 1e-7  # of the border, relative
# Logarithms of the regions are lower bounds, in single precision.
BELOW = 2e-5


@eqx.filter_jit
def decide(equation, y):
    verdict = equation.verdict(y)
    return verdict.outcome, verdict.certified, verdict.stop


def verdict(level, delta, omega):
    """Outcome, certificate and kind of stop of starts, components on axis 0."""
    return map(np.asarray, decide(level(np.asarray(delta)), np.stack(omega)))


def random_states(seed, low, high):
    """Shapes, angles φ, amplitudes u = ω⊥² and signs."""
    rng = np.random.default_rng(seed)
    deltas, angles = rng.uniform(low, high, N), rng.uniform(0, 2 * np.pi, N)
    return deltas, angles, 10.0 ** rng.uniform(-4, 0, N), rng.choice([-1.0, 1.0], (2, N)), rng


def cone(delta):
    """ω₂²/u and |ω₃|/u of the residual region of order 1."""
    ratio = (1 + 2 * delta) / (2 + delta)
    height = np.sqrt(np.abs((1 - delta) * (1 + 2 * delta))) / (np.abs(delta) * (2 + delta))
    return np.where(delta < 0, ratio, 0.5), np.where(delta < 0, height, 0.5 / np.abs(delta))


@pytest.mark.parametrize(("low", "high"), [(-0.499, -0.01), (0.01, 0.99)])
@pytest.mark.parametrize("face", ["width", "height"])
def test_residual_cone_of_order_one(low, high, face):
    delta, _, u, (one, two), rng = random_states(1, low, high)
    width, height = cone(delta)
    inner, part = rng.uniform(0.01, 0.9, (2, N))
    for side, expected in ((1 - NEAR, True), (1 + NEAR, False)):
        across = width * (side if face == "width" else inner)
        along = height * (side if face == "height" else part)
        w1, w2 = one * np.sqrt(u * (1 - across)), two * np.sqrt(u * across)
        omega = w1, w2, one * two * along * u
        outcome, certified, _ = verdict(dt.TransverseReduced, delta, omega)
        # With δ > 0 outside the cone only ω∞ is not known.
        error = np.asarray(dt.TransverseReduced(delta).verdict(jnp.stack(omega)).error)
        assert low < 0 or np.all(np.isfinite(error) == expected)
        assert np.all((outcome == Outcome.RESIDUAL) == (expected or low > 0))
        assert np.all(certified[outcome == Outcome.RESIDUAL])


def test_at_order_one_almost_every_prolate_start_is_residual():
    """Labels are certain at once; the same starts followed up to the cone keep rotating, too."""
    delta, phi, u, (one, _), rng = random_states(11, 0.1, 0.95)
    starts = [np.sqrt(u) * np.cos(phi), np.sqrt(u) * np.sin(phi), one * rng.uniform(0, 30, N) * u]
    equation, starts = dt.TransverseReduced(delta), np.stack(starts, axis=1)
    labels = dt.classify_many(equation, starts, value=False)
    assert np.all(labels.outcome == Outcome.RESIDUAL) & np.all(labels.certified)
    assert not np.any(labels.steps)
    assert np.all(np.isnan(labels.omega_inf))
    followed = dt.classify_many(equation, starts, value="unchecked", slow_flow=False)
    captured = np.isfinite(followed.omega_inf)
    assert np.mean(captured) > 0.95
    assert np.any(followed.steps[captured] > 100)
    assert np.all(followed.omega_inf[captured] != 0)
    assert np.all(followed.outcome == Outcome.RESIDUAL)


@pytest.mark.parametrize("axis", [(0, 0, 0.1), (0, 0.1, 0)])
def test_prolate_tops_on_an_axis_stop_at_order_one(axis):
    run = dt.classify_many(dt.TransverseReduced(0.3), [axis], value=False)
    assert (run.outcome, run.stop) == (Outcome.STOP, Stop.AXIS)
    assert run.certified


def test_areas_divided_by_z_squared_grow_along_planar_motions_of_prolate_tops():
    """div(z⁻²F) = 3δ cos²φ z⁻²/(1−δ) at order 1, on which the proof rests."""

    def weighted(y, delta):
        return planar_rates(delta, 0.0, y) / y[1] ** 2

    rng = np.random.default_rng(12)
    for delta, phi, z in rng.uniform((0.01, 0, 0.1), (0.99, 2 * np.pi, 9), (9, 3)):
        growth = jnp.trace(jax.jacfwd(weighted)(jnp.array([phi, z]), jnp.asarray(delta)))
        expected = 3 * delta * np.cos(phi) ** 2 / (1 - delta) / z**2
        np.testing.assert_allclose(growth, expected, rtol=1e-11)


def turning(swing, bound):
    """The q > S at which ln q + S/q is `bound`: it rises with q from there on."""
    low, high = np.maximum(swing, 1e-6), np.full(N, 1e3)
    for _ in range(80):
        middle = np.sqrt(low * high)
        below = np.log(middle) + swing / middle < bound
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return high


@pytest.mark.parametrize("threshold", [1.0, 1.1])
def test_turning_region_of_order_one(threshold):
    """q = 2|δω₃|/(u + Mω₃²) has two solutions ω₃; on the larger Mω₃² > 0.8u, and 1.1 counts."""
    delta, phi, _, (sign, _), _ = random_states(2, -0.49, -0.05)
    swing = sign * np.sin(2 * phi)
    m, u = 1 + delta + delta**2, 1e-3 * delta**2
    for bound, expected in ((threshold + BELOW, True), (threshold - NEAR, False)):
        q = turning(swing, bound)
        root = np.sqrt(delta**2 - q**2 * m * u)
        w3 = (
            q * u / (np.abs(delta) + root) if threshold == 1.0 else (np.abs(delta) + root) / (q * m)
        )
        assert np.all((m * w3**2 <= 0.8 * u) == (threshold == 1.0))
        omega = np.sqrt(u) * np.cos(phi), np.sqrt(u) * np.sin(phi), sign * w3
        outcome, certified, stop = verdict(dt.TransverseReduced, delta, omega)
        assert np.all((outcome == Outcome.STOP) == expected)
        assert np.all(certified[outcome == Outcome.STOP])
        assert np.all(stop[outcome == Outcome.STOP] == Stop.ROTATING)


def test_turning_needs_more_where_the_axial_part_is_large():
    """Between the bounds 1.0 and 1.1 it counts whether Mω₃² is below 0.8u."""
    delta, phi, _, (sign, _), _ = random_states(10, -0.49, -0.05)
    m, q = 1 + delta + delta**2, turning(sign * np.sin(2 * phi), 1.05)
    for part, expected in ((0.8 * (1 - NEAR), True), (0.8 * (1 + NEAR), False)):
        u = (2 * delta / (q * (1 + part))) ** 2 * part / m
        omega = np.sqrt(u) * np.cos(phi), np.sqrt(u) * np.sin(phi), sign * np.sqrt(part * u / m)
        outcome, *_ = verdict(dt.TransverseReduced, delta, omega)
        assert np.all((outcome == Outcome.STOP) == expected)


def test_beyond_one_half_order_one_stops_unless_w3_is_0():
    _, phi, u, (sign, _), _ = random_states(3, -1, 0)
    flat = np.sqrt(u) * np.cos(phi), np.sqrt(u) * np.sin(phi)
    limit, above = np.full(N, -0.5), np.full(N, -0.5 + NEAR)
    outcome, certified, stop = verdict(dt.TransverseReduced, limit, (*flat, sign * 1e-6 * u))
    assert np.all(outcome == Outcome.STOP) & np.all(certified) & np.all(stop == Stop.ROTATING)
    outcome, certified, _ = verdict(dt.TransverseReduced, limit, (*flat, 0 * u))
    assert np.all(outcome == Outcome.RESIDUAL) & np.all(certified)
    outcome, *_ = verdict(dt.TransverseReduced, above, (*flat, sign * 1e-6 * u))
    assert np.all(outcome == Outcome.UNDECIDED)


def on_ellipse(delta, v, angle):
    """(T, Z) on D(T²+Z²) + [(1+2δ)T + (2v−δ(1−δ))Z]² + [(1−δ)Z − 2T]² = c(δ)."""
    t, z = np.cos(angle), np.sin(angle)
    form = (1 - delta + 4 * v) * (t**2 + z**2)
    form += ((1 + 2 * delta) * t + (2 * v - delta * (1 - delta)) * z) ** 2
    form += ((1 - delta) * z - 2 * t) ** 2
    oblate = np.minimum(1.75 / delta**2, 17 / np.abs(delta))
    size = np.sqrt(np.where(delta < 0, oblate, 3.3 / np.abs(delta)) / form)
    return size * t, size * z


@pytest.mark.parametrize(("low", "high"), [(-1.0, -0.011), (0.021, 0.989)])
def test_residual_region_of_the_semi_reduced_level(low, high):
    delta, angle, v, (sign, _), _ = random_states(4, low, high)
    t, z = on_ellipse(delta, v, angle)
    w1 = sign * np.sqrt(v)
    for side, expected in ((1 - NEAR, True), (1 + NEAR, False)):
        omega = w1, side * t * w1, side * z * v
        outcome, certified, _ = verdict(dt.TransverseSemi, delta, omega)
        assert np.all((outcome == Outcome.RESIDUAL) == expected)
        assert np.all(certified[outcome == Outcome.RESIDUAL])


def test_semi_reduced_residual_rotation_is_proven_up_to_its_limits_only():
    """v = ω₁² ≤ 10 and δ in [−1, −0.01] or [0.02, 0.99]; beyond, the region is tested."""
    inside = [(-0.5, 10), (0.5, 10), (-0.01, 1), (0.02, 1), (0.99, 1), (-1.0, 1)]
    outside = [(-0.5, 10), (0.5, 10), (-0.01, 1), (0.02, 1), (0.99, 1)]
    moved = [(0, 1), (0, 1), (1, 0), (-1, 0), (1, 0)]
    rows = [(d, v * (1 - NEAR * (v == 10)), True) for d, v in inside]
    rows += [
        (d + NEAR * over, v * (1 + NEAR * up), False)
        for (d, v), (over, up) in zip(outside, moved, strict=True)
    ]
    rows += [(0.5, 1e3, False), (-0.9, 1e6, False), (0.5, 9.0, True)]
    delta, v, proven = map(np.array, zip(*(rows * N)[:N], strict=True))
    t, z = on_ellipse(delta, v, np.full(N, 0.7))
    w1 = np.sqrt(v)
    omega = w1, 0.5 * t * w1, 0.5 * z * v
    outcome, certified, _ = verdict(dt.TransverseSemi, delta, omega)
    assert np.all(outcome == Outcome.RESIDUAL)
    np.testing.assert_array_equal(certified, proven)


def turn_of_semi(delta, phi, u, w3):
    """q − S, and ln q + p(1 + a − 2ap)S/q."""
    whole = u + (1 + delta + delta**2) * w3**2
    q, p, a = 2 * np.abs(delta * w3) / whole, u / whole, -3 * delta / (2 * (1 - delta))
    swing = np.sign(w3) * np.sin(2 * phi)
    return q - swing, np.log(q) + p * (1 + a - 2 * a * p) * swing / q


def test_turning_region_of_the_semi_reduced_level():
    delta, phi, _, (sign, _), _ = random_states(5, -1.0, -0.05)
    u = 1e-4 * delta**2
    threshold = np.maximum(0.88, 1.15 - np.abs(delta))

    def reaches(w3, bound):
        ahead, value = turn_of_semi(delta, phi, u, sign * w3)
        return (ahead > 0) & (value >= bound)

    for bound, expected in ((threshold + BELOW, True), (threshold - NEAR, False)):
        # q rises up to ω₃² = u/M, and the value with it where q > S: it is reached for good.
        low, high = 1e-3 * u, np.sqrt(u / (1 + delta + delta**2))
        assert np.all(reaches(high, bound))
        for _ in range(100):
            middle = np.sqrt(low * high)
            there = reaches(middle, bound)
            low, high = np.where(there, low, middle), np.where(there, middle, high)
        w3 = high if expected else low
        omega = np.sqrt(u) * np.cos(phi), np.sqrt(u) * np.sin(phi), sign * w3
        outcome, certified, stop = verdict(dt.TransverseSemi, delta, omega)
        assert np.all((outcome == Outcome.STOP) == expected)
        assert not np.any(certified[outcome == Outcome.STOP])
        assert np.all(stop[outcome == Outcome.STOP] == Stop.ROTATING)


# z_W, where the stable manifold of the saddle crosses ω₁ = 0 in the limit of small amplitudes.
WOBBLE = {
    0.76: 2.4455,
    0.78: 2.7265,
    0.80: 3.0625,
    0.85: 4.2868,
    0.90: 6.7202,
    0.95: 13.992,
    0.97: 23.675,
    0.99: 72.072,
}


def test_wobbling_region_of_the_semi_reduced_level():
    """On the section ω₁ = 0 up to |ω₃|/ω₂² = z_W(1 − 0.005 − 10u/(1−δ)), z_W to five digits."""
    delta, edge = (np.resize(column, N) for column in (list(WOBBLE), list(WOBBLE.values())))
    *_, (sign, other), rng = random_states(6, 0, 1)
    u = rng.uniform(0.0, 1e-3, N) * (1 - delta)
    bound = edge * (1 - 0.005 - 10 * u / (1 - delta))
    for side, expected in ((1 - 1e-4, True), (1 + 1e-4, False)):
        omega = 0 * u, sign * np.sqrt(u), other * side * bound * u
        outcome, certified, stop = verdict(dt.TransverseSemi, delta, omega)
        assert np.all((outcome == Outcome.STOP) == expected)
        assert not np.any(certified)
        assert np.all(stop[outcome == Outcome.STOP] == Stop.WOBBLING)
    below = np.full(N, 0.7532357), 0 * u, np.sqrt(u), 0.1 * u
    outcome, *_ = verdict(dt.TransverseSemi, below[0], below[1:])
    assert not np.any(outcome == Outcome.STOP)


@pytest.mark.parametrize("order", [2, 4])
def test_higher_orders_are_decided_at_small_amplitude_and_never_certified(order):
    """|ω|² ≤ 0.1 for δ ≤ 0.3, ≤ 0.1 min(1, (1−δ)²) above."""
    delta, *_ = random_states(7, -0.99, 0.9)
    limit = np.sqrt(np.where(delta <= 0.3, 0.1, 0.1 * (1 - delta) ** 2))
    way = np.array([1.0, 0.02, 0.02])
    for side, expected in ((1 - NEAR, True), (1 + NEAR, False)):
        omega = side * limit * (way / np.linalg.norm(way))[:, None]
        outcome, certified, _ = verdict(lambda d: dt.TransverseReduced(d, order), delta, omega)
        assert np.all((outcome == Outcome.RESIDUAL) == expected)
        assert not np.any(certified)


@pytest.mark.parametrize(
    ("order", "limit"),
    [
        (2, 0.32441064053),
        pytest.param(3, 0.30185319410, marks=pytest.mark.slow),
        pytest.param(4, 0.30738733339, marks=pytest.mark.slow),
    ],
)
def test_a_fast_residual_rotation_is_decided_at_higher_orders(order, limit):
    """The limits are those of integrations by diffrax up to τ = 400."""
    found = dt.classify(dt.TransverseReduced(-0.2, order), [0.36792, 0.12264, 0.3066])
    assert found.outcome == Outcome.RESIDUAL
    assert not found.certified
    assert found.steps < 50
    assert abs(found.omega_inf - limit) < 3 * found.omega_inf_error < 2e-7


@pytest.mark.parametrize("level", [dt.LongitudinalReduced, dt.LongitudinalSemi])
def test_along_the_axis_every_start_is_certain(level):
    delta, phi, u, (sign, _), _ = random_states(8, -1.0, 0.99)
    omega = np.sqrt(u) * np.cos(phi), np.sqrt(u) * np.sin(phi), sign * u
    outcome, certified, _ = verdict(level, delta, omega)
    assert np.all(outcome == Outcome.RESIDUAL) & np.all(certified)
    outcome, certified, stop = verdict(level, delta, (*omega[:2], 0 * u))
    assert np.all(outcome == Outcome.STOP) & np.all(certified) & np.all(stop == Stop.AXIS)


def test_higher_orders_along_the_axis_are_decided_at_small_amplitude():
    delta, *_ = random_states(9, -1.0, 0.99)
    for side, expected in ((1 - NEAR, Outcome.RESIDUAL), (1 + NEAR, Outcome.UNDECIDED)):
        omega = np.sqrt(0.1) * side * np.array([[0.6], [0.0], [0.8]]) * np.ones(N)
        outcome, certified, _ = verdict(lambda d: dt.LongitudinalReduced(d, 2), delta, omega)
        assert np.all(outcome == expected)
        assert not np.any(certified)
