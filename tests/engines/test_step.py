"""The adaptive step: its size, its time, and the rules by which it is accepted."""

import functools
import operator

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dipoletop as dt
from dipoletop._base.tolerances import Tolerances
from dipoletop._engines.native_engine import NativeEngine
from dipoletop._engines.step import advance, begin
from dipoletop._engines.step_sizes import first_step
from limits_of_runs import limits

MOST_PROGRAMS = 180  # two verdicts, operation by operation: only so are their bits the same

RNG = np.random.default_rng(5)
N = 128
DELTAS = jnp.asarray(RNG.uniform(-0.9, 0.9, N))
STARTS = jnp.asarray(RNG.normal(size=(3, N)) * 0.3)


def test_the_first_step_is_nearly_as_long_as_it_may_be():
    """At every time scale: in proportion to it, and the next step is hardly longer."""
    speeds = jnp.asarray(10.0 ** np.linspace(-30, 3, 34))
    given = limits(speeds[None])
    begun = eqx.filter_jit(begin)(dt.RotatorReduced(), speeds[None], given, 8, "time")
    scaled = np.asarray(begun.h) * np.asarray(speeds) ** 2
    np.testing.assert_allclose(scaled, scaled[0], rtol=1e-9)
    solver = diffrax.Dopri8()
    later = eqx.filter_jit(advance)(begun, given.rtol, given.max_steps, solver, "time")
    growth = np.asarray(later.h) / np.asarray(begun.h)
    assert np.all((growth > 1) & (growth < 4)), growth
    assert np.all(np.asarray(later.t) > 0)


class Still(eqx.Module):
    """y′ = 0, which is never decided."""

    def __call__(self, t, y, args=None):
        return 0 * y

    def lift(self, omega0):
        return omega0

    omega = lift


def test_time_adds_up_without_loss():
    """A hundred thousand steps of 0.1, of which a plain sum loses the last four digits."""
    count, start = 100_000, jnp.ones((3, 1))
    equation, limit = Still(), limits(start, t1=1e9, max_steps=2 * count)
    at = eqx.filter_jit(begin)(equation, start, limit, 3, "time")

    def step(_, at):
        at = eqx.tree_at(lambda at: at.h, at, jnp.full(1, 0.1))
        return advance(at, limit.rtol, limit.max_steps, diffrax.Bosh3(), "time")

    found = float(jax.jit(lambda at: jax.lax.fori_loop(0, count, step, at))(at).t[0])
    assert found == count * 0.1
    # The built-in sum is compensated in Python 3.12 and later.
    assert functools.reduce(operator.add, [0.1] * count) != found


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


@pytest.mark.parametrize("rtol", [1e-5, 1e-9])
def test_steps_are_those_of_the_rules(rtol):
    """A step is accepted if its error is at most the tolerance, and not if it is twice that.

    The JAX engine takes the same steps: `test_both_engines_agree`.
    """
    starts, deltas = np.asarray(STARTS), np.asarray(DELTAS)
    still = eqx.tree_at(lambda x: x.atol, limits(STARTS, rtol, 40.0), jnp.zeros(N))
    equation = dt.TransverseSemi(jnp.asarray(deltas))
    ends = NativeEngine().end_states(equation, STARTS, still, until="time")
    for i in range(0, N, 4):

        def rate(w, d=deltas[i]):
            r2 = -d * w[0] * w[2] - (w @ w + d * (1 + d) * w[2] ** 2) * w[1]
            r3 = (d * w[1] ** 2 - w @ w) * w[2]
            matrix = np.array([[1, 2 * w[0]], [-2 * w[0], 1 - d]])
            return np.array([d * w[1] * w[2], *np.linalg.solve(matrix, [r2, r3])])

        steps, end = reference_steps(rate, starts[:, i], 40.0, rtol)
        assert int(ends.steps[i]) == steps
        np.testing.assert_allclose(ends.y[:, i], end, rtol=0, atol=1e-11)


def test_verdicts_are_the_same_with_what_is_prepared_for_them():
    """The axes of the body, and the averages of the torque on its free rotation."""
    equation = dt.Reduced(dt.Body([[1.7, 0.0, 0.0], [0.0, 1.3, 0.2], [0.0, 0.2, 1.0]], [0.6, 0, 0]))
    y = jnp.array([0.1, -0.3, 0.2])
    seen = equation.prepare()
    plain, prepared = equation.verdict(y), equation.verdict(y, seen)
    jax.tree.map(np.testing.assert_array_equal, plain, prepared)
    written = [str(jax.make_jaxpr(equation.verdict)(y, *given)) for given in ((), (seen,))]
    assert ["atan2" in program for program in written] == [True, False]
