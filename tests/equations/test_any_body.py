"""The verdict for any body, against long integration and the regions of the transverse top."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.accuracy import long_runs
from benchmarks.problems import random_bodies as labels
from dipoletop import Level
from dipoletop._base.types import Outcome, Stop
from dipoletop.bodies import Body
from dipoletop.equations._verdicts import any_body
from dipoletop.equations.rigid import Full, Reduced, SemiReduced
from dipoletop.equations.transverse import TransverseReduced, TransverseSemi

LANES = 16  # of each kind of body
MANY = 320  # states to be judged: always as many, so that a level compiles once
LEVELS = {"1": Level.ORDER_1, "2": Level.ORDER_2, "semi": Level.SEMI}


def principal(rng, n, position):
    """Bodies, no two moments alike, and dipoles along the axis of the moment in that position."""
    j = 1 - np.sort(rng.dirichlet(np.full(3, 4.0), 50 * n), axis=1)[:, ::-1]
    j = j[(np.diff(j, axis=1) > 0.08).all(axis=1) & (j[:, 0] > 0.4)][:n]
    assert j.shape == (n, 3)
    return j, np.tile(np.eye(3)[position], (n, 1))


def turned(rng, j, dipole, omega):
    """The same tops in other axes."""
    turn = labels.random_rotations(rng, len(j))
    inertia = np.einsum("nij,nj,nkj->nik", turn, j, turn)
    dipole, omega = np.einsum("nij,knj->kni", turn, np.stack([dipole, omega]))
    return labels.Starts((inertia + inertia.transpose(0, 2, 1)) / 2, dipole, omega)


@jax.jit
def judge(equation, y):
    return equation.verdict(y)


def verdicts(level, sample):
    return judge(labels.equations(level, *sample[:2]), jnp.asarray(sample.omega.T))


def isotropic(rng, n, low, high):
    omega = rng.normal(size=(n, 3))
    speed = 10 ** rng.uniform(np.log10(low), np.log10(high), n)
    return omega * (speed / np.linalg.norm(omega, axis=1))[:, None]


@pytest.fixture(scope="module")
def runs():
    """Dipole on the largest, the middle and the smallest axis, and on none; the last oblate.

    At order 1; `benchmarks/accuracy/labels.py` has the other levels.
    """
    rng = np.random.default_rng(7)
    largest, middle = principal(rng, LANES, 2), principal(rng, LANES, 1)
    none = principal(rng, LANES, 0)[0], np.tile([0.6, 0.6, np.sqrt(0.28)], (LANES, 1))
    smallest = np.tile([0.5, 0.58, 1.0], (LANES, 1)), np.tile([1.0, 0.0, 0.0], (LANES, 1))
    j, dipole = (np.concatenate(part) for part in zip(largest, middle, none, smallest, strict=True))
    sample = turned(rng, j, dipole, isotropic(rng, 4 * LANES, 0.03, 0.15))
    return long_runs.compare("1", sample, 20.0, budgets=(20_000, 30_000))


@pytest.mark.slow
def test_axis_of_the_dipole_decides(runs):
    # physics of the asymmetric top: largest axis residual, middle and generic stop, smallest both
    largest, middle, none, smallest = runs.outcome.reshape(4, LANES)
    assert (largest == Outcome.RESIDUAL).all()
    assert (middle == Outcome.STOP).all()
    assert (none == Outcome.STOP).all()
    assert {Outcome.RESIDUAL, Outcome.STOP} <= set(smallest) <= {0, 1, 2}


@pytest.mark.slow
def test_long_integration_ends_as_labelled(runs):
    seen = (runs.outcome > 0) & (runs.final > 0)
    assert seen.mean() > 0.8
    np.testing.assert_array_equal(runs.outcome[seen], runs.final[seen])


@pytest.mark.slow
def test_residual_value_is_where_long_integration_ends(runs):
    both = (runs.outcome == Outcome.RESIDUAL) & (runs.final == Outcome.RESIDUAL)
    off = np.abs(runs.omega_inf / runs.value - 1)[both]
    assert both.sum() > LANES
    assert (off <= runs.error[both] + 1e-6).all()  # 1e-6: what the integration itself loses
    assert off.max() < 2e-3


@pytest.mark.parametrize(
    "level", ["1", *(pytest.param(level, marks=pytest.mark.slow) for level in ("2", "semi"))]
)
def test_axisymmetric_body_is_judged_as_the_transverse_top(level):
    rng = np.random.default_rng(5)
    n = MANY
    delta = rng.uniform(-0.95, 0.9, n)
    size, strength = rng.uniform(0.5, 2, n), rng.uniform(0.5, 2, n)
    w = isotropic(rng, n, 0.05, 1.0)  # ω = |d|²Ω/J
    j = size[:, None] * np.stack([np.ones(n), np.ones(n), 1 - delta], axis=1)
    dipole = np.sqrt(strength)[:, None] * np.array([1.0, 0.0, 0.0])
    unit = strength / size
    sample = turned(rng, j, dipole, w / unit[:, None])
    general = verdicts(level, sample)
    order = LEVELS[level].order
    shapes = jnp.asarray(delta)
    closed = TransverseSemi(shapes) if order is None else TransverseReduced(shapes, order)
    expected = judge(closed, jnp.asarray(w.T))
    np.testing.assert_array_equal(general.outcome, expected.outcome)
    np.testing.assert_array_equal(general.stop, expected.stop)
    np.testing.assert_allclose(general.omega_inf * unit, expected.omega_inf, rtol=1e-9)
    assert not general.certified.any()
    assert {1, 2} <= set(np.asarray(general.outcome).tolist())


@pytest.mark.parametrize("family", ["asymmetric", "oblate", "generic"])
def test_rotated_axes_change_nothing(family):
    rng = np.random.default_rng(9)
    sample = labels.starts(family, "1", MANY)
    n = sample.dipole / np.linalg.norm(sample.dipole, axis=1)[:, None]
    near = n * np.sum(n * sample.omega, axis=1)[:, None]  # half of them close to the line
    omega = np.where(np.arange(MANY)[:, None] % 2, sample.omega, near + 0.02 * sample.omega)
    turn = labels.random_rotations(rng, MANY)
    inertia = np.einsum("nij,njk,nlk->nil", turn, sample.inertia, turn)
    dipole, other = np.einsum("nij,knj->kni", turn, np.stack([sample.dipole, omega]))
    here = verdicts("1", sample._replace(omega=omega))
    there = verdicts("1", labels.Starts(inertia, dipole, other))
    np.testing.assert_array_equal(here.outcome, there.outcome)
    np.testing.assert_array_equal(here.stop, there.stop)
    np.testing.assert_allclose(here.omega_inf, there.omega_inf, rtol=1e-9)
    assert (np.asarray(here.outcome) > 0).sum() > 50


@jax.jit
def drift(equation, line, across):
    """ω∞ close to the line, and how it changes compared with w itself: dw/dt is of second order."""
    y = line + 1e-4 * across
    rate = equation(0.0, y)
    value, change = jax.jvp(lambda v: equation.verdict(v).omega_inf, (y,), (rate,))
    mere = jnp.sum(line * rate, axis=0) / jnp.linalg.norm(line, axis=0)
    return value, jnp.abs(change / mere)


@pytest.mark.parametrize("family", ["asymmetric", "near"])
def test_residual_value_does_not_change_along_a_run(family):
    # d ω∞/dt = 0 but for the fourth order: the estimate's derivative along the flow is small
    sample = labels.starts(family, "1", MANY)
    n = sample.dipole / np.linalg.norm(sample.dipole, axis=1)[:, None]
    line = n * np.sum(n * sample.omega, axis=1)[:, None]
    equation = labels.equations("1", *sample[:2])
    value, ratio = drift(equation, jnp.asarray(line.T), jnp.asarray((sample.omega - line).T))
    inside = np.isfinite(value)
    assert inside.sum() > 60
    assert np.quantile(ratio[inside], 0.9) < 1e-3


def single(j, dipole, level=1):
    body = Body(np.diag(j), dipole)
    return SemiReduced(body) if level is None else Reduced(body, level)


@pytest.mark.parametrize("level", [1, None])
def test_exact_motions(level):
    long = single([1.0, 1.0, 1.3], [0.0, 0.0, 1.0], level)  # dipole on the symmetry axis
    held = judge(long, jnp.array([0.03, 0.04, -0.05]))
    assert held.outcome == Outcome.RESIDUAL
    assert held.omega_inf == -0.05
    assert held.error == 0
    assert judge(long, jnp.array([0.03, 0.04, 0.0])).outcome == Outcome.STOP
    body = single([1.0, 1.3, 1.6], [0.0, 0.0, 1.0], level)
    spin = judge(body, jnp.array([0.0, 0.04, 0.0]))
    assert (spin.outcome, spin.stop, spin.omega_inf) == (Outcome.STOP, Stop.AXIS, 0.0)
    assert judge(body, jnp.zeros(3)).outcome == Outcome.STOP
    line = judge(body, jnp.array([0.0, 0.0, -0.1]))
    assert (line.outcome, line.omega_inf, line.error) == (Outcome.RESIDUAL, -0.1, 0.0)
    assert judge(body, jnp.array([jnp.nan] * 3)).outcome == Outcome.UNDECIDED


def test_slowness_decides_nothing():
    # dipole on the largest axis, spin about another, a billion times slower than braking starts
    body = single([1.0, 1.3, 1.6], [0.0, 0.0, 1.0])
    assert judge(body, 1e-12 * jnp.array([0.3, 1.0, 0.2])).outcome == Outcome.UNDECIDED


@pytest.mark.parametrize("level", [pytest.param(Level.ORDER_2, marks=pytest.mark.slow), Level.FULL])
def test_the_line_decides_at_any_amplitude(level):
    # dipole on the largest axis, |d|²|Ω|√tr(I⁻²) = 0.3: where levels above order 1 differ
    body = Body(np.diag([1.0, 0.8, 0.75]), [1.0, 0.0, 0.0])
    equation = Full(body) if level is Level.FULL else Reduced(body, level.order)
    rates = jnp.zeros(3 if level is Level.FULL else 0)  # which decide nothing

    def at(beside):
        omega = jnp.array([-0.15, beside, -beside])
        return judge(equation, jnp.concatenate([omega, rates]))

    for beside in (0.0, 1e-4):
        assert at(beside).outcome == Outcome.RESIDUAL
        assert at(beside).omega_inf == pytest.approx(-0.15, abs=beside)
    assert at(0.15).outcome == Outcome.UNDECIDED


def test_middle_axis_holds_a_fast_residual_rotation():
    # μ² + (1 − a)(1 − b) changes sign at |Ω| = √0.0004; above, the line attracts
    equation = single([0.98, 1.0, 1.02], [0.0, 1.0, 0.0], None)
    assert judge(equation, jnp.array([0.0, 0.1, 1e-6])).outcome == Outcome.RESIDUAL
    assert judge(equation, jnp.array([0.0, 0.005, 1e-6])).outcome == Outcome.STOP
    assert judge(equation, jnp.array([0.0, 0.019, 1e-6])).outcome == Outcome.UNDECIDED


def test_one_top_and_lanes_agree():
    sample = labels.starts("asymmetric", "1", MANY, seed=2)
    many = verdicts("1", sample)
    few = range(16)
    tops = [Reduced(Body(sample.inertia[k], sample.dipole[k])) for k in few]
    one = [judge(tops[k], jnp.asarray(sample.omega[k])) for k in few]
    for field in many._fields[:-2]:  # without the size, which is None, and the class of equation
        each = np.array([getattr(verdict, field) for verdict in one])
        np.testing.assert_allclose(each, getattr(many, field)[: len(few)], rtol=1e-10)


def test_the_odd_terms_of_the_first_order_keep_their_bound():
    """Of odd order in the part x of Ω across the dipole, beside the linear terms of x′."""

    @jax.jit
    @jax.vmap
    def share(j, omega):
        equation = Reduced(Body(jnp.diag(j), jnp.array([1.0, 0.0, 0.0])))
        line, x = omega * jnp.array([1.0, 0.0, 0.0]), omega * jnp.array([0.0, 1.0, 1.0])
        ahead, back = equation(0.0, line + x), equation(0.0, line - x)
        linear = jax.jvp(lambda x: equation(0.0, line + x), (jnp.zeros(3),), (x,))[1]
        odd = (ahead - back) / 2 - linear
        return jnp.max(jnp.abs(odd * j / x)[1:]) / jnp.sum(x**2)

    rng = np.random.default_rng(1)
    largest = share(1 - rng.dirichlet(np.ones(3), 4000), rng.normal(size=(4000, 3))).max()
    assert 0.9 * any_body.ODD_TERMS < largest < any_body.ODD_TERMS


@pytest.mark.slow
def test_the_slope_by_a_tilt_of_equal_axes_is_that_of_the_turned_body():
    """Half a turn about axis 1 changes the signs of Ω₂, Ω₃ and J₁₂: ω∞ changes its sign."""

    # Without optimisation, as other tests, XLA gives slopes of 0.
    @functools.partial(jax.jit, compiler_options={"xla_backend_optimization_level": 1})
    @jax.vmap
    def value_and_slope(omega):
        def value(tilt):
            inertia = jnp.diag(jnp.array([0.8, 0.8, 1.1])).at[0, 1].add(tilt).at[1, 0].add(tilt)
            return Reduced(Body(inertia, jnp.array([0.0, 0.0, 1.0]))).verdict(omega).omega_inf

        return jax.value_and_grad(value)(0.0)

    start = np.array([0.003, 0.004, 0.1])
    found = value_and_slope(jnp.asarray([start, start * [1, -1, -1]]))
    (here, there), slopes = (np.asarray(part) for part in found)
    assert here == pytest.approx(-there, rel=1e-14)
    assert here > 0.09
    assert slopes[0] == pytest.approx(slopes[1], rel=1e-12)
    assert slopes[1] > 1e-4
