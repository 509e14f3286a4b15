"""The native engine: it agrees with the JAX engine, and its threads share one queue."""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dipoletop as dt
from dipoletop._engines import native_engine
from dipoletop._engines.interface import Limits, Queue
from dipoletop._engines.jax_engine import JaxEngine
from dipoletop._engines.native_engine import NativeEngine
from dipoletop._runs.label_doubt import finish_of
from dipoletop._runs.memory_limits import part_of
from limits_of_runs import limits as limits_of

RNG = np.random.default_rng(11)


def problem(make, size=0.3, n=128):
    """Equations of many shapes, their starts and limits."""
    deltas = jnp.asarray(RNG.uniform(-0.9, 0.7, n))
    starts = jnp.asarray(RNG.normal(size=(3, n)) * size)
    made = jax.vmap(make, out_axes=-1)(deltas), starts, limits_of(starts, max_steps=3000)
    return jax.device_put(made, jax.devices()[0])  # or what follows from these compiles again


def by_both(equation, y0, limits, solver, **until):
    engines = NativeEngine(solver), JaxEngine(solver)
    return [engine.end_states(equation, y0, limits, **until) for engine in engines]


def at_a_given_time(equation, y0, limits, **options):
    """The states of the runs that get there agree, whatever the steps; and how many these are."""
    limits = eqx.tree_at(lambda x: x.t1, limits, jnp.minimum(limits.t1, 5.0))
    fast, slow = by_both(equation, y0, limits, **options)
    there = np.asarray(slow.t == 5.0)
    assert np.array_equal(fast.t == 5.0, there)
    tolerance = 1e-9 * float(jnp.max(jnp.abs(y0)))
    np.testing.assert_allclose(fast.y[:, there], slow.y[:, there], rtol=0, atol=tolerance)
    return np.mean(there)


def test_both_engines_agree():
    """The same labels, steps but for one in a hundred runs, and states at a given time."""
    equation, starts, limits = problem(dt.TransverseReduced)
    solver = diffrax.Dopri8()
    y0 = equation.lift(starts)
    fast, slow = by_both(equation, y0, limits, solver=solver)
    assert np.array_equal(fast.status, slow.status)
    counts = np.stack([fast.steps, slow.steps])
    assert np.mean(counts[0] != counts[1]) <= 0.01
    assert np.all(np.ptp(counts, axis=0) <= 2 + 0.02 * counts[1])
    verdicts = [eqx.filter_jit(lambda e, y: e.verdict(y))(equation, e.y) for e in (fast, slow)]
    assert np.array_equal(verdicts[0][0], verdicts[1][0])
    assert at_a_given_time(equation, y0, limits, solver=solver) > 0.5


class Braked(eqx.Module):
    """ω′ = −ω²ω with another power of ω², which ends on a small sphere: short to compile."""

    power: int

    def __call__(self, t, y, args=None):
        return -(jnp.sum(y**2, axis=0) ** self.power)[None] * y

    def lift(self, omega0):
        return omega0

    omega = lift

    def verdict(self, y):
        done = jnp.sum(y**2, axis=0) < 0.01
        return jnp.where(done & (y[0] > 0), 1, jnp.where(done, 2, 0)), 0 * y[0], done


def test_programs_that_were_not_used_for_long_are_given_up(monkeypatch):
    monkeypatch.setattr(native_engine, "_programs", {})
    monkeypatch.setattr(native_engine, "KEPT", 2)
    starts = np.array([[0.2, 0.01, 0.1], [-0.1, 0.2, 0.3]])
    levels = [Braked(1), Braked(2), Braked(3)]
    found = [dt.classify_many(level, starts, value=False).outcome for level in levels]
    assert len(native_engine._programs) == 2
    last = list(native_engine._programs)
    dt.classify_many(levels[1], starts, value=False)  # is compiled no more, and now the newest
    assert list(native_engine._programs) == last[::-1]
    again = dt.classify_many(levels[0], starts, value=False).outcome
    np.testing.assert_array_equal(again, found[0])


class Fading(Braked):
    """A third component that falls exponentially beside others that are constant."""

    def __call__(self, t, y, args=None):
        return jnp.stack([0 * y[0], 0 * y[0], -y[2]])


def test_subnormal_numbers_count_as_zero_during_a_run_and_only_then():
    last = np.linspace(0.1, 2.0, 16)
    limits = Limits(jnp.asarray(1e-6), 0 * last, jnp.asarray(last), jnp.asarray(10_000))
    starts = np.array([[1.0], [1.0], [4e-308]]) * np.ones(16)
    ends = NativeEngine().end_states(Fading(1), starts, limits, until="time")
    assert np.all(ends.t == last)
    least, fading = np.finfo(float).tiny, ends.y[2]
    assert np.all((fading >= least) | (fading == 0))
    assert np.any(fading > 0)
    assert np.any(fading == 0)
    assert np.all(np.full(8, least) * 0.5 > 0)


def test_threads_share_the_queue():
    equation, starts, limits = problem(dt.TransverseReduced, n=1003)

    def found(threads):
        queue = Queue(equation, starts, limits, "value")
        return NativeEngine().classify(finish_of(True), queue, jax.devices()[0], threads)[0]

    jax.tree.map(np.testing.assert_array_equal, found(1), found(3))


def test_a_paused_run_goes_on_as_if_it_had_not_been_paused():
    """Also one that has taken no step; one that has ended after some steps stays as it is."""
    equation, starts, limits = problem(dt.TransverseReduced, n=203)
    rests = limits._replace(t1=jnp.where(jnp.arange(203) % 5 == 0, 0.0, limits.t1))

    def found(limits, paused=None):
        queue = Queue(equation, starts, limits, "value", paused, pauses=True)
        device = jax.devices()[0]
        return NativeEngine().classify(finish_of(True), queue, device, 2)

    whole, _ = found(limits)
    first, paused = found(rests._replace(max_steps=jnp.asarray(20)))
    assert 10 < np.count_nonzero(first.runs.steps == 20) < 160
    _, paused = found(limits._replace(max_steps=jnp.asarray(30)), paused)
    later, _ = found(limits, paused)
    lanes = np.flatnonzero(whole.runs.steps > 0)
    here, there = (part_of(ended, lanes, 203) for ended in (later, whole))
    jax.tree.map(np.testing.assert_array_equal, here, there)


def test_after_an_interruption_no_thread_takes_another_start():
    queue = np.zeros(1, np.intp)

    def interrupted():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        native_engine._in_threads(interrupted, 2, queue, 100)
    assert queue[0] == 100
