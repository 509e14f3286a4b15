"""The lane engines: they agree with diffrax, and no lane disturbs another."""

import functools
from dataclasses import replace

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dipoletop as dt
from dipoletop._base.stopping import BROKEN, EXHAUSTED, FINISHED
from dipoletop._base.tolerances import Tolerances
from dipoletop._engines import jax_engine
from dipoletop._engines.interface import Limits
from dipoletop._engines.jax_engine import JaxEngine
from dipoletop._engines.native_engine import NativeEngine
from dipoletop._engines.step import advance, begin
from dipoletop._engines.step_sizes import first_step

RNG = np.random.default_rng(5)
N = 384  # a multiple of every block width, as the tiles of a sweep are
DELTAS = jnp.asarray(RNG.uniform(-0.9, 0.9, N))
STARTS = jnp.asarray(RNG.normal(size=(3, N)) * 0.3)


both = pytest.mark.parametrize("engine", [JaxEngine(), NativeEngine()], ids=lambda e: e.name)


def limits(starts, rtol=1e-9, t1=jnp.inf, max_steps=100_000):
    size = jnp.sqrt(jnp.sum(starts**2, axis=0))
    return Limits(
        jnp.asarray(rtol), rtol * size, jnp.full(starts.shape[1], t1), jnp.asarray(max_steps)
    )


@both
@pytest.mark.parametrize("solver", [diffrax.Dopri8(), diffrax.Bosh3()])
def test_end_states_equal_those_of_diffrax(solver, engine):
    """Same equation, same tableau, two step controllers: equal within the tolerance."""
    rtol = 1e-9 if solver.order(None) > 3 else 1e-6
    ends = replace(engine, solver=solver).end_states(
        dt.TransverseSemi(DELTAS), STARTS, limits(STARTS, rtol, 30.0), until="time"
    )
    assert bool(jnp.all(ends.status == FINISHED))
    assert bool(jnp.all(ends.t == 30.0))
    for i in range(0, N, 50):
        run = dt.simulate(
            dt.TransverseSemi(DELTAS[i]), STARTS[:, i], jnp.array([0.0, 30.0]), rtol=1e-12
        )
        error = jnp.max(jnp.abs(ends.y[:, i] - run.omega[-1]))
        assert float(error) < 100 * rtol * float(jnp.linalg.norm(STARTS[:, i]))


@both
def test_exact_solution_and_error_in_proportion_to_the_tolerance(engine):
    """Plane rotator (2.4) in every lane, each with its own Ω₀, whatever the shape."""
    speeds = jnp.linspace(0.1, 3.0, N)
    starts = jnp.stack([0 * speeds, speeds, 0 * speeds])
    equation = dt.TransverseSemi(DELTAS)
    exact = speeds / jnp.sqrt(1 + 2 * speeds**2 * 40)
    for rtol in (1e-5, 1e-8, 1e-11):
        ends = engine.end_states(equation, starts, limits(starts, rtol, 40.0), until="time")
        assert float(jnp.max(jnp.abs(ends.y[1] - exact) / speeds)) < 20 * rtol


@both
def test_a_lane_does_not_see_its_neighbours(engine):
    """Position in the queue, its length, block width and company change no bit of a result."""
    run = functools.partial(engine.end_states, until="outcome")
    ends = run(dt.TransverseReduced(DELTAS), STARTS, limits(STARTS))
    order = RNG.permutation(N)
    others = [run(dt.TransverseReduced(DELTAS[order]), STARTS[:, order], limits(STARTS[:, order]))]
    if engine == JaxEngine():
        some = order
        run = functools.partial(JaxEngine(width=64).end_states, until="outcome")
        others.append(run(dt.TransverseReduced(DELTAS), STARTS, limits(STARTS)))
    else:
        some = order[:101]
        few = STARTS[:, some]
        others.append(run(dt.TransverseReduced(DELTAS[some]), few, limits(few)))
    for name in ("y", "t", "steps", "status"):
        first = np.asarray(getattr(ends, name))
        mixed, other = (np.asarray(getattr(found, name)) for found in others)
        assert np.array_equal(first[..., order], mixed)
        assert np.array_equal(first if engine == JaxEngine() else first[..., some], other)


@both
def test_bad_lanes_fail_at_once_and_harm_no_other(engine):
    starts = np.array(STARTS)
    bad = {3: np.nan, 50: np.inf, 120: 1e200, 121: -1e40}
    for lane, value in bad.items():
        starts[1, lane] = value
    starts[:, 200] = 0.0
    deltas = DELTAS.at[250].set(jnp.nan)
    clean = engine.end_states(dt.TransverseReduced(DELTAS), STARTS, limits(STARTS), until="outcome")
    ends = engine.end_states(
        jax.vmap(dt.TransverseReduced)(deltas), jnp.asarray(starts), limits(STARTS), until="outcome"
    )
    lost = [*bad, 250]
    assert np.all(np.asarray(ends.status)[lost] == BROKEN)
    assert np.all(np.asarray(ends.steps)[lost] == 0)
    assert ends.status[200] == FINISHED
    others = np.setdiff1d(np.arange(N), [*lost, 200])
    assert np.array_equal(np.asarray(ends.y)[:, others], np.asarray(clean.y)[:, others])
    assert np.array_equal(np.asarray(ends.steps)[others], np.asarray(clean.steps)[others])


def test_the_first_step_is_nearly_as_long_as_it_may_be():
    """At every time scale: in proportion to it, and the next step is hardly longer."""
    speeds = 10.0 ** jnp.linspace(-30, 3, 34)
    given = limits(speeds[None])
    begun = begin(dt.RotatorReduced(), speeds[None], given, 8, "time")
    scaled = np.asarray(begun.h * speeds**2)
    np.testing.assert_allclose(scaled, scaled[0], rtol=1e-9)
    later = advance(begun, given.rtol, given.max_steps, diffrax.Dopri8(), "time")
    growth = np.asarray(later.h / begun.h)
    assert np.all((growth > 1) & (growth < 4)), growth
    assert np.all(np.asarray(later.t) > 0)


@both
def test_budget_is_counted_in_steps(engine):
    ends = engine.end_states(
        dt.TransverseReduced(DELTAS), STARTS, limits(STARTS, max_steps=3), until="outcome"
    )
    assert int(jnp.max(ends.steps)) == 3
    assert bool(jnp.all(ends.status[ends.steps == 3] != BROKEN))
    assert bool(jnp.any(ends.status == EXHAUSTED))


def test_lanes_are_refilled():
    """The blocks make far fewer lane-steps than lockstep would: slowest lane times all lanes."""
    ends = JaxEngine(width=64).end_states(
        dt.TransverseReduced(DELTAS), STARTS, limits(STARTS), until="outcome"
    )
    wide, narrow = (int(n) for n in ends.block_steps)
    made, used = wide * 64 + narrow * 8, int(jnp.sum(ends.steps))
    assert used <= made < 0.2 * N * int(jnp.max(ends.steps))


class Decay(eqx.Module):
    """A user's own equation: y′ = −r y in two components, decided when it has halved."""

    rate: jax.Array

    def __call__(self, t, y, args=None):
        return jnp.stack([-self.rate * y[0], -self.rate * y[1]])

    def lift(self, omega0):
        return omega0[:2]

    def omega(self, y):
        return jnp.concatenate([y, y[:1]])

    def verdict(self, y):
        done = y[0] < 0.5
        return (
            jnp.where(done, int(dt.Outcome.RESIDUAL), 0),
            jnp.where(done, self.rate, jnp.nan),
            done,
        )


@both
def test_a_users_own_equation(engine):
    """Three methods and a three-valued verdict are all that the engine asks for."""
    rates = jnp.linspace(0.5, 2.0, 10)
    found = dt.classify_many(Decay(rates), jnp.ones((10, 3)), engine=engine.name)
    assert np.all(found.outcome == dt.Outcome.RESIDUAL)
    assert np.allclose(found.omega_inf, rates)
    assert np.all(found.time >= np.log(2) / rates)
    one = dt.classify(Decay(jnp.asarray(0.7)), jnp.ones(3))
    assert float(one.omega_inf) == 0.7


class Swing(Decay):
    """y′ = r cos(τ) y, whose right-hand side depends on time: y = exp(r sin τ)."""

    def __call__(self, t, y, args=None):
        return jnp.stack([self.rate * jnp.cos(t) * y[0], self.rate * jnp.cos(t) * y[1]])


@both
@pytest.mark.parametrize("solver", [diffrax.Dopri8(), diffrax.Heun()])
def test_a_right_hand_side_that_depends_on_time(solver, engine):
    rates, starts = jnp.linspace(0.1, 1.0, 128), jnp.ones((2, 128))
    ends = replace(engine, solver=solver).end_states(
        Swing(rates), starts, limits(starts, 1e-6, 2.0), until="time"
    )
    assert float(jnp.max(jnp.abs(ends.y - jnp.exp(rates * jnp.sin(2.0))[None]))) < 1e-4


def test_time_adds_up_without_loss():
    """A hundred thousand steps of 0.1, of which a plain sum loses the last four digits."""
    count, start = 100_000, jnp.ones((2, 1))
    equation, limit = Decay(jnp.zeros(1)), limits(start, t1=1e9, max_steps=2 * count)
    at = begin(equation, start, limit, 3, "time")

    def step(_, at):
        at = eqx.tree_at(lambda at: at.h, at, jnp.full(1, 0.1))
        return advance(at, limit.rtol, limit.max_steps, diffrax.Bosh3(), "time")

    found = float(jax.jit(lambda at: jax.lax.fori_loop(0, count, step, at))(at).t[0])
    assert found == count * 0.1
    assert sum([0.1] * count) != found


class Explosion(Decay):
    """y′ = +y³: runs away in a finite time and is never decided."""

    def __call__(self, t, y, args=None):
        return y**3

    def verdict(self, y):
        never = y[0] < -1.0
        return never.astype(int), y[0] * jnp.nan, never


@both
def test_a_runaway_is_failed_in_bounded_work(engine):
    found = dt.classify_many(Explosion(jnp.ones(4)), jnp.ones((4, 3)), engine=engine.name)
    assert np.all(found.outcome == dt.Outcome.FAILED)
    assert found.steps.max() < 2000
    assert np.all(found.time <= 0.5 + 1e-9)
    one = dt.classify(Explosion(jnp.asarray(1.0)), jnp.ones(3))
    assert int(one.outcome) == dt.Outcome.FAILED


class Wall(Explosion):
    """y′ = −1, which ends at y = ½: no step leads further."""

    def __call__(self, t, y, args=None):
        return jnp.where(y > 0.5, -jnp.ones_like(y), jnp.nan)


@both
def test_a_step_that_shrinks_to_nothing_is_failed_in_bounded_work(engine):
    found = dt.classify_many(Wall(jnp.ones(4)), jnp.ones((4, 3)), engine=engine.name)
    assert np.all(found.outcome == dt.Outcome.FAILED)
    assert found.steps.max() < 200
    np.testing.assert_allclose(found.time, 0.5, rtol=1e-12)


def test_a_second_call_with_other_values_compiles_nothing():
    def run(shift):
        start = STARTS + shift
        equation = dt.TransverseReduced(DELTAS * (1 - shift))
        now = limits(start, 1e-8 + shift * 1e-9)
        return JaxEngine().end_states(equation, start, now, until="outcome")

    run(0.0)
    with jax.log_compiles(), jax.checking_leaks():
        before = jax_engine._jitted("cpu")._cached._cache_size()
        run(0.01)
        assert jax_engine._jitted("cpu")._cached._cache_size() == before


def size(y):
    """What errors are measured by: ω⊥ across the axis, and along it ω₃ or ω⊥ min(ω⊥, 1)."""
    across = max(abs(y[0]), abs(y[1]))
    return np.array([across, across, max(abs(y[2]), across * min(across, 1.0))])


def reference_steps(rate, y, t1, rtol):
    """One run by the rules that `step` states, in plain Python: steps tried, and the end."""
    tableau = diffrax.Dopri8().tableau
    tolerances = Tolerances(jnp.asarray(rtol), jnp.zeros(()))
    order = int(diffrax.Dopri8().order(None))
    field = lambda t, y, args: jnp.asarray(rate(y))  # noqa: E731
    ours = lambda y: jnp.asarray(size(np.asarray(y)))  # noqa: E731
    begun = jnp.asarray(y), jnp.asarray(rate(y))
    h = float(first_step(field, ours, *begun, tolerances, order))
    t, steps = 0.0, 0
    while t < t1:
        last, k = h >= t1 - t, [rate(y)]
        h = min(h, t1 - t)
        for row in tableau.a_lower:
            k.append(rate(y + h * np.asarray(row) @ np.array(k)))
        new = y + h * tableau.b_sol @ np.array(k)
        error = np.abs(h * tableau.b_error @ np.array(k))
        ratio = np.max(error / (rtol * np.maximum(size(y), size(new))))
        steps += 1
        if ratio <= 1:
            y, t = new, t1 if last else t + h
        # the order, 8, is a power of two: no rounding of it
        h *= np.clip(0.9 * ratio ** (-1 / 8), 0.2, 10.0 if ratio <= 1 else 1.0)
    return steps, y


@both
@pytest.mark.parametrize("rtol", [1e-5, 1e-9])
def test_steps_are_those_of_the_rules(engine, rtol):
    """A step is accepted if its error is at most the tolerance, and not if it is twice that."""
    starts, deltas = np.asarray(STARTS[:, :128]), np.asarray(DELTAS[:128])
    still = eqx.tree_at(lambda x: x.atol, limits(STARTS[:, :128], rtol, 40.0), jnp.zeros(128))
    equation = dt.TransverseSemi(jnp.asarray(deltas))
    ends = engine.end_states(equation, STARTS[:, :128], still, until="time")
    for i in range(0, 128, 4):

        def rate(w, d=deltas[i]):
            r2 = -d * w[0] * w[2] - (w @ w + d * (1 + d) * w[2] ** 2) * w[1]
            r3 = (d * w[1] ** 2 - w @ w) * w[2]
            matrix = np.array([[1, 2 * w[0]], [-2 * w[0], 1 - d]])
            return np.array([d * w[1] * w[2], *np.linalg.solve(matrix, [r2, r3])])

        steps, end = reference_steps(rate, starts[:, i], 40.0, rtol)
        assert int(ends.steps[i]) == steps
        np.testing.assert_allclose(ends.y[:, i], end, rtol=0, atol=1e-11)
