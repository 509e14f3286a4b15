"""Motions along the physical branch: balance laws, and two independent routes."""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from branched import STARTS, TOP, Branched, isotropic
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import dipoletop as dt
from dipoletop._runs.sensitivity import decay_time

# 1000 braking times, T = 1/ω². Always as many times: what follows a motion compiles once.
TIMES = jnp.concatenate([jnp.array([0.0, 60.0]), jnp.geomspace(100.0, 1000 / 0.08, 50)])


@pytest.fixture(scope="module")
def many():
    """Small starts of all directions, the last two replaced by those of figure 2."""
    starts = isotropic(4, 0.15)
    starts[-2:] = [*STARTS.values()]
    return starts, dt.classify_many(TOP, starts)


@pytest.fixture(scope="module", params=STARTS, ids=["residual", "stop"])
def long(request):
    start = STARTS[request.param]
    return start, dt.simulate(TOP, start, TIMES, rtol=1e-11, balance=True)


@eqx.filter_jit
def balance_defect(run):
    return run.balance_defect


def test_energy_balance_over_a_thousand_braking_times(long):
    _, run = long
    assert float(jnp.max(jnp.abs(balance_defect(run)))) < 1e-11
    assert run.stats["num_steps"] < 100


def test_backwards_it_is_an_ordinary_integration(long):
    """Backwards the branch attracts: diffrax must come back to the start from where we are."""
    start, run = long
    back = diffrax.diffeqsolve(
        diffrax.ODETerm(TOP),
        diffrax.Dopri8(),
        60.0,
        0.0,
        -0.01,
        run.ys[1],
        stepsize_controller=diffrax.PIDController(1e-13, 1e-15),
    )
    np.testing.assert_allclose(back.ys[-1][:3], start, rtol=0, atol=2e-11)


def test_outcomes_are_those_of_the_motion(long, many):
    start, run = long
    starts, found = many
    (here,) = np.flatnonzero(np.all(starts == np.asarray(start), axis=1))
    stops = found.outcome[here] == dt.Outcome.STOP
    assert stops == (start[1] > 0.1)
    assert not found.certified[here]
    assert abs(found.omega_inf[here] - (0 if stops else run.omega[-1, 0])) < 1e-9


@pytest.mark.slow
def test_half_of_the_energy_to_be_lost_is_lost_when_it_is_said_to_be(long):
    start, _ = long
    half = decay_time(TOP, start)
    first, then, *_, last = dt.simulate(
        TOP, start, TIMES.at[1].set(half), rtol=1e-11, balance=True
    ).energy
    # At that last time the energy left over is the residual one, or falls like 1/τ.
    rest = last if start[1] < 0.1 else 0.0
    assert float(then) == pytest.approx(float(first + rest) / 2, rel=1e-9)


@pytest.mark.slow
def test_derivatives_of_the_residual_rotation():
    """By shape and start, backwards, against differences of order 6."""
    start, way, step = jnp.array([0.2, 0.05, 0.05]), jnp.array([1.0, 0.3, -0.2, 0.4]), 4e-3

    def value(change):
        top = dt.TransverseFull(change[0] - 0.2)
        return dt.residual_rotation(top, start + change[1:], rtol=1e-10)

    slopes = jax.jit(jax.grad(value))(jnp.zeros(4))
    moves = jnp.outer(step * jnp.array([-3.0, -2.0, -1.0, 1.0, 2.0, 3.0]), way)
    tops = dt.TransverseFull(moves[:, 0] - 0.2)
    around = dt.classify_many(tops, start[None] + moves[:, 1:], rtol=1e-12).omega_inf
    found = np.array([-1, 9, -45, 45, -9, 1]) / (60 * step) @ around
    assert float(slopes @ way) == pytest.approx(found, rel=1e-8)


def rotator(t, y):
    """(A.1): ω″ = ω′ + ω³."""
    return y[1], y[1] + y[0] ** 3


class Isotropic(Branched):
    """ω̇ = a, ȧ = a + ω²ω: rotators that feel nothing of each other, and no more than (A.1)."""

    rest = 0.15

    def __call__(self, t, y, args=None):
        return jnp.concatenate([y[3:], y[3:] + jnp.sum(y[:3] ** 2) * y[:3]])

    def reduced(self, order):
        def rate(t, w):  # −ω³ + 3ω⁵ − 24ω⁷ + …
            square = jnp.sum(w**2)
            series = 1.0 - 3.0 * (order > 1) * square + 24.0 * (order > 2) * square**2
            return -series * square * w

        return rate

    @property
    def semi(self):
        return self.reduced(1)


@pytest.mark.slow
def test_a_single_start_is_followed_until_it_is_decided():
    """Backwards the branch attracts, so any start behind it shows when it passes 0.2 and 0.15."""
    found = dt.classify(Isotropic(), jnp.array([0.0, 0.16, 0.12]))
    assert found.outcome == dt.Outcome.STOP
    assert not found.certified

    def passes(speed):
        event = lambda t, y: y[0] - speed  # noqa: E731
        event.terminal = True
        tight = {"rtol": 1e-12, "atol": 1e-14, "events": event}
        return solve_ivp(rotator, (0, -1e4), [0.12, -(0.12**3)], "DOP853", **tight).t[-1]

    exact = passes(0.15) - passes(0.2)
    assert exact * (1 - 1e-7) < found.time < 2 * exact  # where an element of a window ends
    fast, too_fast = (dt.classify(Isotropic(), jnp.array([0.0, w, 0.0])) for w in (1e3, 1e12))
    assert fast.outcome == dt.Outcome.STOP
    assert too_fast.outcome == dt.Outcome.FAILED


@pytest.mark.slow
@pytest.mark.parametrize("speed", [3.0, 1e3])
def test_fast_rotations_come_from_where_they_began(speed):
    """Backwards, an ordinary integration passes the start when the run began."""
    run = dt.simulate(Isotropic(), jnp.array([0.0, speed, 0.0]), [0.0, 20.0], rtol=1e-9)
    begins = lambda t, y: y[0] - speed  # noqa: E731
    begins.terminal = True
    tight = {"rtol": 1e-12, "atol": 1e-14, "events": begins}
    back = solve_ivp(rotator, (20.0, -1.0), run.ys[-1, [1, 4]], "DOP853", **tight)
    assert abs(back.t[-1]) < 1e-8


@pytest.mark.slow
@pytest.mark.parametrize("off", [1e-15, 1e-9, 1e-6])
def test_a_start_beside_the_residual_rotation_is_followed(off):
    """It hardly moves, so that its first window would be as long as 1/off."""
    top = dt.TransverseFull(-0.5)
    run = dt.simulate(top, [0.3, off, off], [0.0, 50.0])
    in_axes = np.array([[0.0, 1.0], [-1.0, 0.0]])  # the axes a and b of the spectrum are 3 and −2
    linear = in_axes.T @ np.asarray(dt.spectrum(top, [0.3, 0.0, 0.0]).across) @ in_axes
    rounding = 4e-18 / off
    expected = expm(50.0 * linear) @ [1.0, 1.0]
    np.testing.assert_allclose(run.omega[-1, 1:] / off, expected, atol=rounding + 1e-7)


def slowed(equation, y):
    """The motion in σ = ∫|ω|²dτ, in which braking takes as long at any size."""
    return equation(0.0, y) / jnp.sum(y**2, axis=0)[None]


@eqx.filter_jit
def long_after(equation, y, h=0.05, steps=600):
    """By the classical Runge–Kutta method."""

    def stage(i, carry):
        start, total, slope = carry
        part = jnp.asarray([0.0, 0.5, 0.5, 1.0])[i]
        slope = slowed(equation, start + h * part * slope)
        return start, total + jnp.asarray([1.0, 2.0, 2.0, 1.0])[i] / 6 * slope, slope

    def step(_, y):
        return y + h * jax.lax.fori_loop(0, 4, stage, (y, 0 * y, 0 * y))[1]

    return jax.lax.fori_loop(0, steps, step, y)


def test_many_starts_agree_with_the_third_order(many):
    starts, found = many
    third = np.asarray(long_after(dt.TransverseReduced(-0.2, order=3), jnp.asarray(starts.T)))
    on_line = np.linalg.norm(third[1:], axis=0) < 1e-3 * np.abs(third[0])
    caught = found.outcome == dt.Outcome.RESIDUAL
    assert np.array_equal(caught, on_line)
    assert set(found.outcome) == {dt.Outcome.RESIDUAL, dt.Outcome.STOP}
    caught &= np.linalg.norm(starts, axis=1) < 0.2
    np.testing.assert_allclose(found.omega_inf[caught], third[0, caught], rtol=4e-3)


@pytest.mark.slow
def test_prolate_tops_are_decided_beside_the_residual_line():
    """Where |ω| > 0.3 (1 − δ) the tested regions end; the line is stable at any amplitude."""
    starts = isotropic(5, 0.25)
    found = dt.classify_many(dt.TransverseFull(0.6), starts)
    assert np.all(found.outcome == dt.Outcome.RESIDUAL)
    assert np.max(np.abs(found.omega_inf)) > 0.14
    for i in range(2):
        run = dt.simulate(dt.TransverseFull(0.6), starts[i], TIMES * 2e4 / TIMES[-1])
        assert abs(run.omega[-1, 0] - found.omega_inf[i]) < 1e-7


@pytest.mark.slow
def test_sweep_and_bad_lanes():
    def problem(delta, amplitude):
        return dt.TransverseFull(delta), amplitude * jnp.array([0.8, 0.1, 0.03])

    amplitudes = np.linspace(0.02, 0.1, 24)
    amplitudes[-1] = 9.0
    basin = dt.sweep(problem, dt.Grid(delta=[-0.3, 0.95], amplitude=amplitudes))
    assert basin.level == "full"
    assert basin.attrs["engine"] == "branch"
    assert np.all(basin.outcome[0, :-1] == dt.Outcome.RESIDUAL)
    assert basin.outcome[1, -1] == dt.Outcome.FAILED  # no branch there


def test_off_the_branch_no_verdict_holds():
    full, state = dt.TransverseFull(-0.2), jnp.array([0.2, 1e-3, 1e-3, 0.0, 0.0])
    assert full.verdict(state).outcome == dt.Outcome.RESIDUAL  # were it on the branch
    assert dt.classify(full, state, max_steps=1).outcome == dt.Outcome.UNDECIDED


@pytest.mark.slow
def test_off_the_branch_a_top_runs_away():
    """The plane rotator (A.1) blows up as ω = √2/(τ₁ − τ) (A.5); the time is reported."""
    state = jnp.array([0.0, 0.2, 0.0, 0.1, 0.0])
    found = dt.classify(TOP, state)
    assert found.outcome == dt.Outcome.FAILED
    left = float(found.time) * 1e-4
    tight = {"rtol": 1e-12, "atol": 1e-14}
    near = solve_ivp(rotator, (0, float(found.time) - left), [0.2, 0.1], "DOP853", **tight)
    assert abs(near.y[0, -1] * left / np.sqrt(2) - 1) < 1e-3
    assert dt.classify(TOP, TOP.lift(STARTS[np.pi / 30])).outcome == dt.Outcome.FAILED


@pytest.mark.slow
def test_where_there_is_no_branch():
    needle, start = dt.TransverseFull(0.95), jnp.array([3.0, 2.0, 4.0])
    with pytest.raises(RuntimeError, match="could not be followed"):
        dt.simulate(needle, start, TIMES)

    def last(delta):
        return dt.simulate(dt.TransverseFull(delta), start, TIMES, throw=False).omega[-1]

    found, slope = jax.jit(lambda delta: jax.jvp(last, (delta,), (1.0,)))(0.95)
    assert jnp.all(jnp.isnan(found))
    assert jnp.all(jnp.isnan(slope))
