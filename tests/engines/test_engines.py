"""All engines: they agree with diffrax, and no lane disturbs another."""

import functools
from concurrent.futures import ThreadPoolExecutor

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dipoletop as dt
from dipoletop._base.stopping import BROKEN, EXHAUSTED, FINISHED
from dipoletop._engines import jax_engine
from dipoletop._engines.branch_engine import BranchEngine
from dipoletop._engines.jax_engine import JaxEngine
from dipoletop._engines.native_engine import NativeEngine
from limits_of_runs import limits

RNG = np.random.default_rng(5)
N = 384  # a multiple of every block width, as the tiles of a sweep are
DELTAS = jnp.asarray(RNG.uniform(-0.9, 0.9, N))
STARTS = jnp.asarray(RNG.normal(size=(3, N)) * 0.3)


SHORT = JaxEngine(diffrax.Tsit5())  # its programs take a third of the time to compile
JAX_SLOW = [pytest.param(SHORT, marks=pytest.mark.slow), NativeEngine()]


def test_end_states_by_another_method_equal_those_of_diffrax():
    """Same equation, two step controllers: equal within the tolerance.

    Of the usual methods see `test_the_error_follows_the_tolerance`.
    """
    engine, rtol = NativeEngine(diffrax.Bosh3()), 1e-6
    given = limits(STARTS, rtol, 30.0)
    ends = engine.end_states(dt.TransverseSemi(DELTAS), STARTS, given, until="time")
    assert np.all(ends.status == FINISHED)
    assert np.all(ends.t == 30.0)
    for i in range(0, N, 50):
        run = dt.simulate(dt.TransverseSemi(DELTAS[i]), STARTS[:, i], [0.0, 30.0], rtol=1e-12)
        error = np.max(np.abs(ends.y[:, i] - run.omega[-1]))
        assert error < 100 * rtol * np.linalg.norm(STARTS[:, i])


@pytest.mark.parametrize("engine", JAX_SLOW, ids=lambda e: e.name)
def test_a_lane_does_not_see_its_neighbours(engine):
    """Position in the queue, its length and company change no bit of a result."""
    run = functools.partial(engine.end_states, until="outcome")
    ends = run(dt.TransverseReduced(DELTAS), STARTS, limits(STARTS))
    order = RNG.permutation(N)
    lengths = [N] if engine == SHORT else [N, 101]  # each compiles again in JAX
    for some in (order[:length] for length in lengths):
        few = jnp.asarray(np.asarray(STARTS)[:, some])
        deltas = jnp.asarray(np.asarray(DELTAS)[some])
        same(run(dt.TransverseReduced(deltas), few, limits(few)), ends, some)


def same(found, ends, order):
    """The same bits, but for the order."""
    for name in ("y", "t", "steps", "status"):
        one, other = (np.asarray(getattr(each, name)) for each in (found, ends))
        assert np.array_equal(one, other[..., order])


@pytest.mark.parametrize("engine", [SHORT, NativeEngine()], ids=lambda e: e.name)
def test_budget_is_counted_in_steps(engine):
    ends = engine.end_states(
        dt.TransverseReduced(DELTAS), STARTS, limits(STARTS, max_steps=3), until="outcome"
    )
    steps, status = np.asarray(ends.steps), np.asarray(ends.status)
    assert np.max(steps) == 3
    assert np.all(status[steps == 3] != BROKEN)
    assert np.any(status == EXHAUSTED)


class Own(eqx.Module):
    """A user's own equations in two components, by their kind, so that they compile once.

    0: y′ = −r y, decided when it has halved. 1: y′ = +y³, which runs away in a finite time and is
    never decided. 2: y′ = −1, which ends at y = ½: no step leads further.
    """

    rate: jax.Array
    kind: jax.Array

    def __call__(self, t, y, args=None):
        return jnp.stack([self.of(y[0]), self.of(y[1])])

    def of(self, x):
        wall = jnp.where(x > 0.5, -1.0, jnp.nan)
        return jnp.where(self.kind == 0, -self.rate * x, jnp.where(self.kind == 1, x**3, wall))

    def lift(self, omega0):
        return omega0[:2]

    def omega(self, y):
        return jnp.concatenate([y, y[:1]])

    def verdict(self, y):
        done = (self.kind == 0) & (y[0] < 0.5)
        return (
            jnp.where(done, int(dt.Outcome.RESIDUAL), 0),
            jnp.where(done, self.rate, jnp.nan),
            done,
        )


@pytest.mark.parametrize("engine", JAX_SLOW, ids=lambda engine: engine.name)
def test_a_users_own_equation(engine):
    """Three methods and a three-valued verdict are all that the engine asks for.

    A runaway, and a step that shrinks to nothing, fail in bounded work and harm no other lane.
    """
    kinds = np.repeat([0.0, 1.0, 2.0], [8, 2, 2])
    rates = np.linspace(0.5, 2.0, 12)
    found = dt.classify_many(Own(rates, kinds), np.ones((12, 3)), engine=engine.name)
    decay, runaway, wall = np.split(np.arange(12), [8, 10])
    assert np.all(found.outcome[decay] == dt.Outcome.RESIDUAL)
    assert np.allclose(found.omega_inf[decay], rates[decay])
    assert np.all(found.time[decay] >= np.log(2) / rates[decay])
    assert np.all(found.outcome[[*runaway, *wall]] == dt.Outcome.FAILED)
    assert found.steps[runaway].max() < 2000
    assert np.all(found.time[runaway] <= 0.5 + 1e-9)
    assert found.steps[wall].max() < 200
    np.testing.assert_allclose(found.time[wall], 0.5, rtol=1e-12)


def test_one_run_of_a_users_own_equation():
    one, failed = (
        dt.classify(Own(np.array(0.7), np.array(kind)), np.ones(3)) for kind in (0.0, 1.0)
    )
    assert float(one.omega_inf) == 0.7
    assert failed.outcome == dt.Outcome.FAILED


class Swing(Own):
    """y′ = r cos(τ) y, whose right-hand side depends on time: y = exp(r sin τ)."""

    def __call__(self, t, y, args=None):
        return jnp.stack([self.rate * jnp.cos(t) * y[0], self.rate * jnp.cos(t) * y[1]])


@pytest.mark.parametrize("engine", JAX_SLOW, ids=lambda engine: engine.name)
def test_a_right_hand_side_that_depends_on_time(engine):
    """Other methods are tried in `test_every_explicit_method_has_its_order`."""
    rates, starts = jnp.linspace(0.1, 1.0, 128), jnp.ones((2, 128))
    ends = engine.end_states(
        Swing(rates, 0 * rates), starts, limits(starts, 1e-6, 2.0), until="time"
    )
    assert np.max(np.abs(np.asarray(ends.y) - np.exp(np.asarray(rates) * np.sin(2.0)))) < 1e-4


def test_a_second_call_with_other_values_compiles_nothing():
    def run(shift):
        start = STARTS + shift
        equation = dt.TransverseReduced(DELTAS * (1 - shift))
        now = limits(start, 1e-8 + shift * 1e-9)
        return SHORT.end_states(equation, start, now, until="outcome")

    run(0.0)
    with jax.log_compiles(), jax.checking_leaks():
        before = jax_engine._INTEGRATE[True]._cached._cache_size()
        run(0.01)
        assert jax_engine._INTEGRATE[True]._cached._cache_size() == before


@pytest.mark.slow
def test_threads_follow_branches_at_the_same_time():
    """Their dense systems are solved by LAPACK, whose batched calls would wait for each other."""
    equation = dt.TransverseFull(jnp.full(4, -0.2))
    y0 = equation.lift(0.2 * jnp.eye(3, 4) + 0.1)
    bounds = limits(y0[:3], t1=30.0)

    def run(_):
        return BranchEngine().end_states(equation, y0, bounds, until="outcome")

    alone = run(0)
    with ThreadPoolExecutor(6) as threads:
        for together in threads.map(run, range(24)):
            np.testing.assert_array_equal(together.y, alone.y)
