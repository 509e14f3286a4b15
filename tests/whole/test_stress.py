"""The integrators where it is hard: orders, tolerances, corners of the domain, the separatrix.

`benchmarks/accuracy/labels.py` compares random labels with long integration.
"""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dipoletop as dt
from dipoletop import Outcome
from dipoletop._base.stopping import FINISHED
from dipoletop._engines.interface import Limits
from dipoletop._engines.jax_engine import JaxEngine
from dipoletop._engines.native_engine import NativeEngine
from dipoletop._engines.step import begin, runge_kutta_step
from limits_of_runs import limits

RNG = np.random.default_rng(19)
N = 256  # lanes of every block that is integrated to given times
# One program for each engine, in JAX of a shorter method.
NATIVE = NativeEngine()
ENGINES = [pytest.param(JaxEngine(diffrax.Tsit5()), id="jax", marks=pytest.mark.slow), NATIVE]
both = pytest.mark.parametrize("engine", ENGINES, ids=lambda engine: engine.name)

METHODS = [
    diffrax.Heun(),
    diffrax.Midpoint(),
    diffrax.Ralston(),
    diffrax.Bosh3(),
    diffrax.Tsit5(),
    diffrax.Dopri5(),
    diffrax.Dopri8(),
]
STEPS = {2: (128, 256), 3: (128, 256), 5: (128, 256), 8: (24, 32)}  # of an order
transverse = jax.jit(jax.vmap(dt.exact.transverse, (0, -1, 0), -1))
longitudinal = jax.jit(jax.vmap(dt.exact.longitudinal, (0, -1, 0), -1))


class Pulsed(eqx.Module):
    """The longitudinal top times cos τ, so that it depends on time: (3.11) at the time sin τ."""

    top: dt.LongitudinalReduced

    def __call__(self, t, y, args=None):
        return jnp.cos(t)[None] * self.top(t, y)

    def lift(self, omega0):
        return omega0

    omega = lift


def test_every_explicit_method_has_its_order():
    """Steps of one size, without a controller; lanes differ in their number."""
    assert {type(m) for m in METHODS} == set(diffrax.AbstractERK.__subclasses__())
    delta, start, end = 0.95, jnp.array([0.3, 0.2, 4.0]), 1.5

    @jax.jit
    def ends():
        return [at_fixed_steps(m, delta, start, end, STEPS[m.order(None)]) for m in METHODS]

    exact = np.asarray(jax.jit(dt.exact.longitudinal)(delta, start, np.sin(end)))
    for method, found in zip(METHODS, ends(), strict=True):
        order = method.order(None)
        few, many = np.max(np.abs(np.asarray(found) - exact[:, None]), axis=0)
        slope = np.log(few / many) / np.log(STEPS[order][1] / STEPS[order][0])
        assert abs(slope - order) < 0.1, (method, slope)


def at_fixed_steps(method, delta, start, end, counts):
    number = jnp.asarray(counts)
    h = end / number.astype(float)
    zero = jnp.zeros_like(h)
    once = Limits(jnp.asarray(1.0), 1 + zero, zero + end, jnp.asarray(1))
    y = jnp.repeat(start[:, None], len(counts), axis=1)
    equation = Pulsed(dt.LongitudinalReduced(delta + zero))
    begun = begin(equation, y, once, 1, "time")  # but for its step size

    def step(k, at):
        y, f, _ = runge_kutta_step(method, at.equation, at, h, at.t1)
        new = eqx.tree_at(lambda at: (at.y, at.f, at.t), at, (y, f, at.t + h))
        return jax.tree.map(lambda new, old: jnp.where(k < number, new, old), new, at)

    return jax.lax.fori_loop(0, max(counts), step, begun).y


def run(engine, equation, starts, times, rtol=1e-9):
    """End states at given times."""
    return engine.end_states(equation, starts, limits(starts, rtol, times), until="time")


def solved():
    """Starts of the transverse top with a closed solution, 20 braking times of each."""
    deltas = RNG.uniform(-0.9, 0.9, N)
    way = RNG.normal(size=(3, N))
    way[2, ::3] = 0  # ω₃ = 0
    way[:2, 1::3] = 0  # ω⊥ = 0
    deltas[2::3] = 0  # a sphere
    starts = way / np.linalg.norm(way, axis=0) * 10 ** RNG.uniform(-1, 0.5, N)
    times = 20 / np.sum(starts**2, axis=0)
    given = jnp.asarray(deltas), jnp.asarray(starts), jnp.asarray(times)
    return dt.TransverseReduced(given[0]), *given[1:], transverse(*given)


TOP = solved()


def spinning():
    """The longitudinal top, whose velocity turns up to 200 times."""
    deltas, times = jnp.asarray(RNG.uniform(-0.9, 0.9, N)), TOP[2]
    starts = RNG.normal(size=(3, N))
    starts *= np.sqrt(20 / np.asarray(times)) / np.linalg.norm(starts, axis=0)
    starts = jnp.asarray(starts)
    return dt.LongitudinalReduced(deltas), starts, times, longitudinal(deltas, starts, times)


def rotators():
    """At every stage of braking: what was wrong at first is forgotten in the end."""
    speeds = np.linspace(0.1, 3.0, N)
    times = np.geomspace(0.05, 20, N)[::-1] / speeds**2
    exact = jax.jit(jax.vmap(dt.exact.rotator))(speeds, times)
    return dt.RotatorReduced(), jnp.asarray(speeds[None]), jnp.asarray(times), exact[None]


@pytest.mark.parametrize(
    ("make", "engine"),
    [
        pytest.param(lambda: TOP, JaxEngine(diffrax.Tsit5()), marks=pytest.mark.slow),
        (lambda: TOP, NATIVE),
        (spinning, NATIVE),
        (rotators, NATIVE),
    ],
)
def test_the_error_follows_the_tolerance(make, engine):
    """At most 5 × rtol|ω₀|, and in proportion, over eight decades."""
    equation, starts, times, exact = make()
    size = np.linalg.norm(starts, axis=0)
    rtols = 10.0 ** -np.arange(4, 13)
    errors = []
    for rtol in rtols:
        ends = run(engine, equation, starts, times, rtol)
        assert np.all(np.asarray(ends.status) == FINISHED)
        errors.append(np.max(np.abs(np.asarray(ends.y) - exact) / size))
    assert np.all(errors < 5 * rtols), errors
    slope = np.polyfit(np.log(rtols), np.log(errors), 1)[0]
    assert abs(slope - 1) < 0.15, (slope, errors)


@both
def test_invariant_sets_stay_so_to_the_last_bit(engine):
    """ω₃ = 0 keeps ω₁, too; ω₁ = ω₃ = 0 and ω⊥ = 0 are axes; a sphere keeps ω₁."""
    equation, starts, times, _ = TOP
    ends = jax.tree.map(np.asarray, run(engine, equation, starts, times))
    starts = np.asarray(starts)
    flat, axis, sphere = (np.arange(k, N, 3) for k in range(3))
    assert np.array_equal(ends.y[0, flat], starts[0, flat])
    assert np.all(ends.y[2, flat] == 0)
    assert np.all(ends.y[:2, axis] == 0)
    assert np.array_equal(ends.y[0, sphere], starts[0, sphere])
    across = np.concatenate([np.zeros((1, N)), starts[1:]])
    ends = jax.tree.map(np.asarray, run(engine, equation, jnp.asarray(across), times))
    assert np.all(ends.y[0, flat] == 0)
    assert np.all(ends.y[2, flat] == 0)


@both
def test_tight_tolerances_and_long_times(engine):
    """The tightest rtol there is, up to 10³⁰ braking times: no step vanishes, no time is lost."""
    equation, starts, _, _ = TOP
    starts = np.array(starts)
    starts[0] = 0.0  # all of it decays; a constant ω₁ would limit the steps
    times = 10 ** np.linspace(0, 30, N) / np.sum(starts**2, axis=0)
    ends = run(engine, equation, jnp.asarray(starts), jnp.asarray(times), rtol=5e-15)
    assert np.all(np.asarray(ends.status) == FINISHED)
    assert np.all(np.asarray(ends.t) == times)
    exact = np.asarray(transverse(equation.delta, starts, times))
    error = np.max(np.abs(np.asarray(ends.y) - exact), axis=0) / np.linalg.norm(starts, axis=0)
    assert np.max(error) < 1e-13


@both
def test_reflections_and_braking_across_the_axis(engine):
    """Mirrored starts have mirrored ends, bit by bit; ω⊥ never increases (4.9)."""
    deltas = jnp.asarray(np.repeat(RNG.uniform(-1, 0.95, N // 8), 8))
    starts = jnp.asarray(np.repeat(RNG.normal(size=(3, N // 8)), 8, axis=1))
    times = jnp.asarray(np.resize(10 ** np.linspace(-2, 2.5, 8), N))
    equation = dt.TransverseReduced(deltas)
    ends = run(engine, equation, starts, times)
    for signs in ([1.0, -1.0, -1.0], [-1.0, -1.0, 1.0]):
        mirror = jnp.array(signs)[:, None]
        image = run(engine, equation, mirror * starts, times)
        assert np.array_equal(image.y, mirror * ends.y)
        assert np.array_equal(image.steps, ends.steps)
    across = np.hypot(ends.y[0], ends.y[1]).reshape(-1, 8)
    size = np.linalg.norm(starts, axis=0).reshape(-1, 8)[:, 0]
    assert np.all(np.max(np.diff(across, axis=1), axis=1) < 1e-8 * size)


def corners():
    """Shapes at −1, −1/2, 0, 1 and one place beside; axes and planes; |ω| from 1e-300 to 10."""
    shapes = [-1, np.nextafter(-1, 0), np.nextafter(-0.5, -1), -0.5, np.nextafter(-0.5, 0)]
    shapes += [-1e-15, 0.0, 1e-15, -0.2, 0.3, 1 - 1e-12, np.nextafter(1, 0)]
    sizes = [1e-280, 1e-30, 1e-3, 10]
    ways = [(1, 0), (1, 1), (0, 1), (-1, 1), (0, -1), (1, -1), (1, 1e-3), (0, 0)]
    grid = np.meshgrid(shapes, sizes, np.arange(len(ways)), [0, 1e-9, -1e-3, 1, 1e6], indexing="ij")
    deltas, sizes, way, axial = (values.ravel() for values in grid)
    across = np.asarray(ways, float)[way.astype(int)]
    return deltas, np.column_stack([sizes * across[:, 0], sizes * across[:, 1], sizes * axial])


def certain(d, omega):
    """What order 1 must come to, where that is known of a start without integration; else 0."""
    w1, w2, w3 = omega.T
    keeps = (w3 == 0) | (d == 0)
    stop = (w1 == 0) & ((w2 == 0) | keeps) | ~keeps & (d <= -0.5)
    residual = (w1 != 0) & keeps | (d > 0)  # but for a surface, where nothing must be decided
    return np.select([stop, residual], [Outcome.STOP, Outcome.RESIDUAL], 0)


SHAPES, CORNERS = corners()


def labels(engine, deltas, starts, rtol=1e-8, max_steps=250):
    """With few steps: what is slow must say so. One program for each engine."""
    return dt.classify_many(
        jax.vmap(dt.TransverseReduced)(jnp.asarray(deltas)),
        starts,
        rtol=rtol,
        value=False,
        max_steps=max_steps,
        engine=engine.name,
        slow_flow=False,
    )


@both
def test_corners_of_the_domain_and_a_block_with_bad_lanes(engine):
    """Every verdict right or none; what is not a number fails at once and harms no other lane."""
    found = labels(engine, SHAPES, CORNERS)
    expected = certain(SHAPES, CORNERS)
    decided = found.outcome > 0
    assert np.all((found.outcome == expected)[decided & (expected > 0)])
    exact = (CORNERS[:, 2] == 0) | (SHAPES == 0) | (SHAPES <= -0.5)
    assert np.all(decided[exact])
    assert np.mean(decided) > 0.75
    assert np.all(found.outcome[~decided] == Outcome.UNDECIDED)
    assert np.all(found.steps <= 250)
    across = np.hypot(CORNERS[:, 0], CORNERS[:, 1])
    assert not np.any(np.abs(found.omega_inf) > across * (1 + 1e-6))

    starts, shapes = CORNERS.copy(), SHAPES.copy()
    bad = RNG.choice(len(starts), 40, replace=False)
    starts[bad, RNG.integers(0, 3, 40)] = np.resize([np.nan, np.inf, -np.inf, 1e200], 40)
    rest = bad[::8]
    starts[rest] = 0.0
    shapes[bad[1]] = np.nan
    starts[bad[1]] = 0.1
    again = labels(engine, shapes, starts)
    lost = np.setdiff1d(bad, rest)
    assert np.all(again.outcome[lost] == Outcome.FAILED)
    assert np.all(again.steps[bad] == 0)
    assert np.all(again.outcome[rest] == Outcome.STOP)
    others = np.setdiff1d(np.arange(len(starts)), bad)
    for name in ("outcome", "omega_inf", "time", "steps", "certified", "stop"):
        before, after = getattr(found, name), getattr(again, name)
        assert np.array_equal(before[others], after[others], equal_nan=True)


# δ = −1/5, ω⊥ = ω₃ = 1/5: below this φ residual, above it a stop. By Taylor series of order 26 in
# 80-bit numbers, without any certificate: benchmarks/accuracy/separatrix.py.
EDGE = 0.29626034320137483


@both
def test_a_wall_of_starts_at_the_separatrix(engine):
    """On both sides at distances 1e-2 … 1e-14: no wrong label farther away than rtol.

    Where two tolerances are wrong alike, which `confirm` cannot tell, the tighter one cannot, too.
    """
    far = np.repeat(10.0 ** -np.arange(2, 14.5, 0.5), 4) * np.resize([1.0, 1.3, 1.7, 2.4], 100)
    angles = np.concatenate([EDGE - far, EDGE + far])
    distance = angles - EDGE
    side = np.where(distance < 0, Outcome.RESIDUAL, Outcome.STOP)
    fixed = jnp.full(200, 0.2)
    starts = np.asarray(dt.cylindrical(fixed, fixed, angles))
    starts = np.resize(starts, CORNERS.shape)
    before = None
    for rtol in (1e-4, 1e-8, 1e-12):
        found = labels(engine, np.full(len(starts), -0.2), starts, rtol, max_steps=2000)
        assert np.all(found.certified)
        outcome = found.outcome[:200]
        wrong = outcome != side
        assert np.max(np.abs(distance)[wrong], initial=0.0) < rtol
        assert np.any(wrong) or rtol < 1e-4  # tight tolerances may err nowhere
        if before is not None:
            hidden = wrong & (before == outcome)
            assert np.max(np.abs(distance)[hidden], initial=0.0) < rtol
        before = outcome
