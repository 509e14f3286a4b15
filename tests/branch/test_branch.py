"""The physical branch of the full equations: exact values, balance, and two independent routes."""

import itertools

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import dipoletop as dt
from dipoletop._runs.sensitivity import decay_time

TOP = dt.TransverseFull(-0.2)
STARTS = {phi: dt.cylindrical(0.2, 0.2, phi) for phi in (np.pi / 30, np.pi / 3)}
# 1000 braking times, T = 1/ω². Always as many times: what follows a motion compiles once.
TIMES = jnp.concatenate([jnp.array([0.0, 60.0]), jnp.geomspace(100.0, 1000 / 0.08, 50)])


def branch(equation, omega):
    return dt.slow_manifold(equation, omega, with_error=True)


# Tabulated values of f(ω), ff′ = f + ω³, the branch of the plane rotator (A.1).
@pytest.mark.parametrize(
    ("speed", "exact", "tolerance"),
    [
        (0.1, -0.00097215149697444904, 1e-14),
        (0.3, -0.022428220160021891, 1e-13),
        (1.0, -0.4734467160950165281, 3e-14),
        (10.0, -67.523066735607424581, 1e-10),
    ],
)
def test_plane_rotator(speed, exact, tolerance):
    rate, error = branch(TOP, jnp.array([0.0, speed, 0.0]))
    assert abs(rate[1] / exact - 1) < tolerance
    assert abs(rate[1] - exact) < error < 1e-9 * abs(exact)
    assert jnp.all(rate[jnp.array([0, 2])] == 0)


@pytest.mark.parametrize(
    ("phi", "exact"),
    [(np.pi / 30, (0.00913023, -0.00967855)), (np.pi / 3, (-0.00532417, -0.01342288))],
)
def test_transverse_top(phi, exact):
    """(ω₂′, ω₃′) at the starts of figure 2."""
    rate, error = branch(TOP, STARTS[phi])
    np.testing.assert_allclose(rate[1:], exact, rtol=0, atol=6e-9)
    assert error < 1e-12


class WithShortLevels(eqx.Module):
    """The general equation, its levels in the short closed forms, which compile far faster."""

    general: dt.Full
    special: dt.TransverseFull

    def __getattr__(self, name):
        return getattr(self.special if name in ("semi", "reduced") else self.general, name)

    def __call__(self, t, y, args=None):
        return self.general(t, y, args)


def test_the_general_equation_has_the_same_branch():
    body, start = dt.axisymmetric(-0.2), STARTS[np.pi / 3]
    general = dt.Full(body)
    rate, _ = branch(WithShortLevels(general, TOP), start)
    np.testing.assert_allclose(rate, branch(TOP, start)[0], rtol=1e-12)
    # The levels of the same body are the same: `test_equations`.
    assert eqx.tree_equal(general.semi, dt.SemiReduced(body))
    assert eqx.tree_equal(general.reduced(3), dt.Reduced(body, 3))


@pytest.mark.parametrize("delta", [-0.9, -0.2, 0.6])
def test_runaway_rate(delta):
    """1 and 1 − δ for the transverse top; in general the spectrum of the fast part at rest."""
    bodies = (
        dt.axisymmetric(delta),
        dt.Body(np.diag([0.7, 1.0, 1.5 + delta / 3]), [0.6, 0.3, 0.8]),
    )
    assert float(dt.TransverseFull(delta).runaway_rate) == min(1.0, 1 - delta)
    for body in bodies:
        rates = np.sort(np.linalg.eigvals(np.asarray(at_rest(body))).real)[-2:]
        np.testing.assert_allclose(dt.Full(body).runaway_rate, rates[0], rtol=1e-12)
    same = dt.Full(bodies[0]).runaway_rate
    np.testing.assert_allclose(same, dt.TransverseFull(delta).runaway_rate, rtol=1e-12)


@jax.jit
def at_rest(body):
    """The Jacobian of the full equation where nothing moves."""
    return jax.jacfwd(lambda y: dt.Full(body)(0.0, y))(jnp.zeros(6))


@pytest.mark.parametrize("wanted", [1e-10, 1e-5])
def test_a_requested_accuracy(wanted):
    """The estimate covers the error, and what misses the request is not given."""
    rng = np.random.default_rng(2)
    sizes = np.geomspace(0.05, 4.0, 24)[:, None]
    ways = rng.normal(size=(24, 3))
    starts = jnp.asarray(sizes * ways / np.linalg.norm(ways, axis=1, keepdims=True))

    def at(rtol):
        return [dt.slow_manifold(TOP, start, rtol=rtol, with_error=True) for start in starts]

    for (rate, error), (best, rest) in zip(at(wanted), at(wanted / 100), strict=True):
        size = jnp.max(jnp.abs(rate))
        if jnp.isfinite(size):
            assert error <= wanted * size
        if jnp.isfinite(size + best[0]):
            assert jnp.max(jnp.abs(rate - best)) <= error + rest
    found = [bool(jnp.isfinite(rate[0])) for rate, _ in at(wanted)]
    assert np.mean(found) > 0.6


def test_derivatives_of_the_branch():
    """By shape and start, backwards, against differences of order 6."""
    start, way, step = dt.cylindrical(0.2, 0.2, np.pi / 30), jnp.array([0.3, -0.2, 0.4]), 4e-3

    def rate(change, moved):
        return dt.slow_manifold(dt.TransverseFull(change - 0.2), start + moved)[1]

    slopes = jax.jit(jax.grad(rate, (0, 1)))(0.0, jnp.zeros(3))
    around = [rate(k * step, k * step * way) for k in (-3, -2, -1, 1, 2, 3)]
    found = np.array([-1, 9, -45, 45, -9, 1]) / (60 * step) @ jnp.array(around)
    assert float(slopes[0] + slopes[1] @ way) == pytest.approx(float(found), rel=1e-10)


def test_small_amplitudes_have_the_series():
    """The orders approach the branch, each by a power of ω more."""
    start = jnp.array([0.3, 0.5, -0.4])
    for scale, least in ((0.02, 3.0), (0.01, 6.0)):
        rate, _ = branch(TOP, scale * start)
        errors = [float(jnp.max(jnp.abs(order - rate))) for order in series(scale * start)]
        assert all(low * least < high for high, low in itertools.pairwise(errors))


@jax.jit
def series(omega):
    return [dt.TransverseReduced(-0.2, m)(0.0, omega) for m in (1, 2, 3, 4)]


def isotropic(seed, size):
    ways = np.random.default_rng(seed).normal(size=(48, 3))
    return size * ways / np.linalg.norm(ways, axis=1, keepdims=True)


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


def test_half_of_the_energy_to_be_lost_is_lost_when_it_is_said_to_be(long):
    start, _ = long
    half = decay_time(TOP, start)
    first, then, *_, last = dt.simulate(
        TOP, start, TIMES.at[1].set(half), rtol=1e-11, balance=True
    ).energy
    # At that last time the energy left over is the residual one, or falls like 1/τ.
    rest = last if start[1] < 0.1 else 0.0
    assert float(then) == pytest.approx(float(first + rest) / 2, rel=1e-9)


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


class Isotropic(eqx.Module):
    """ω̇ = a, ȧ = a + ω²ω: rotators that feel nothing of each other, and no more than (A.1)."""

    runaway_rate: jax.Array = eqx.field(default_factory=lambda: jnp.asarray(1.0))
    body: dt.Body = eqx.field(default_factory=lambda: dt.Body(np.eye(3), [1.0, 0.0, 0.0]))

    def __call__(self, t, y, args=None):
        return jnp.concatenate([y[3:], y[3:] + jnp.sum(y[:3] ** 2) * y[:3]])

    def reduced(self, order):
        def rate(t, w):  # −ω³ + 3ω⁵ − …
            square = jnp.sum(w**2)
            return -(square - 3.0 * (order > 1) * square**2) * w

        return rate

    @property
    def semi(self):
        return self.reduced(1)

    def fast(self, rate):
        return rate

    def omega_dot(self, y):
        return y[3:]

    def lift(self, omega):
        return jnp.concatenate([omega, self.semi(0.0, omega)])

    def omega(self, y):
        return y[:3]

    def verdict(self, y):
        slow = jnp.sum(y[:3] ** 2) < 0.15**2
        return jnp.where(slow, int(dt.Outcome.STOP), 0), jnp.zeros(()), ~slow


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
    assert dt.classify(Isotropic(), jnp.array([0.0, 1e3, 0.0])).outcome == dt.Outcome.FAILED


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


def test_prolate_tops_are_decided_beside_the_residual_line():
    """Where |ω| > 0.3 (1 − δ) the tested regions end; the line is stable at any amplitude."""
    starts = isotropic(5, 0.25)
    found = dt.classify_many(dt.TransverseFull(0.6), starts)
    assert np.all(found.outcome == dt.Outcome.RESIDUAL)
    assert np.max(np.abs(found.omega_inf)) > 0.14
    for i in range(2):
        run = dt.simulate(dt.TransverseFull(0.6), starts[i], TIMES * 2e4 / TIMES[-1])
        assert abs(run.omega[-1, 0] - found.omega_inf[i]) < 1e-7


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


def test_where_there_is_no_branch():
    needle, start = dt.TransverseFull(0.95), jnp.array([3.0, 2.0, 4.0])
    with pytest.raises(RuntimeError, match="could not be followed"):
        dt.simulate(needle, start, TIMES)

    def last(delta):
        return dt.simulate(dt.TransverseFull(delta), start, TIMES, throw=False).omega[-1]

    found, slope = jax.jvp(last, (jnp.asarray(0.95),), (jnp.ones(()),))
    assert jnp.all(jnp.isnan(found))
    assert jnp.all(jnp.isnan(slope))


def test_refusals():
    with pytest.raises(ValueError, match=r"`equation` must be a full equation, but is Transverse"):
        dt.slow_manifold(dt.TransverseSemi(-0.2), jnp.ones(3))
    with pytest.raises(ValueError, match=r"`rtol` must lie between .* is 2"):
        dt.slow_manifold(TOP, jnp.ones(3), rtol=2.0)
    with pytest.raises(ValueError, match=r"`omega` must be finite"):
        dt.slow_manifold(TOP, jnp.array([0.1, jnp.nan, 0.0]))
    with pytest.raises(ValueError, match=r"`engine` must be 'auto' or 'jax' .* equation is full"):
        dt.classify_many(TOP, jnp.ones((1, 3)), engine="native")
    with pytest.raises(ValueError, match=r"`options` must be `throw` or `balance` .* is `solver`"):
        dt.simulate(TOP, jnp.ones(3), jnp.array([0.0, 1.0]), solver=diffrax.Tsit5())
