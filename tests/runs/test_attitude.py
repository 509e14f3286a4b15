"""The attitude in the laboratory: closed forms, the balance of angular momentum, derivatives."""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from settling import FIGURE_2A, difference

import dipoletop as dt
from dipoletop._base.attitudes import unit_quaternion

COUNT = 82  # of times; motions along the branch with as many times are compiled once
LEVEL = [1.0, 0.0, 0.0, 0.0]  # body axes along those of the laboratory
TILTED = np.array([0.5, 0.1, -0.7, 0.5])  # a unit quaternion
TIMES = jnp.array([0.0, 3.0, 7.0])
GENERIC = dt.Body(jnp.diag(jnp.array([1.0, 1.3, 2.2])), jnp.array([0.6, 0.5, 0.4]))


class Euler(eqx.Module):
    """Free rotation about principal axes, an equation of a user's own without a body."""

    moments: jax.Array = eqx.field(converter=jnp.asarray)

    def __call__(self, t, y, args=None):
        """Ω̇ = −I⁻¹ Ω×IΩ."""
        return -jnp.cross(y, self.moments * y) / self.moments

    def lift(self, omega0):
        """The state is ω."""
        return omega0

    omega = lift


def about(axis, angle):
    """The quaternions of rotations about an axis; in NumPy."""
    half = np.asarray(angle)[..., None] / 2
    return np.concatenate([np.cos(half), np.sin(half) * np.asarray(axis)], axis=-1)


def matrix(q):
    """The rotation matrix of a unit quaternion, in the form of textbooks; in NumPy."""
    s, x, y, z = np.moveaxis(np.asarray(q), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - s * z), 2 * (x * z + s * y)],
        [2 * (x * y + s * z), 1 - 2 * (x * x + z * z), 2 * (y * z - s * x)],
        [2 * (x * z - s * y), 2 * (y * z + s * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def distance(found, expected):
    """How far the rotations by two quaternions are apart: the largest component of a vector."""
    return np.abs(matrix(found) - expected).max()


@pytest.mark.slow
@pytest.mark.parametrize("solver", [None, diffrax.Tsit5()])
def test_plane_rotator_turns_by_the_integral_of_its_speed(solver):
    """(2.4): ∫ω dτ = (√(1 + 2Ω₀²τ) − 1)/Ω₀ about axis 3; the error follows the tolerance."""
    ts, speed = jnp.linspace(0.0, 1000.0, 11), 0.8
    angle = (np.sqrt(1 + 2 * speed**2 * np.asarray(ts)) - 1) / speed
    expected = matrix(TILTED) @ matrix(about([0.0, 0.0, 1.0], angle))
    errors = []
    for rtol in (1e-6, 1e-11):
        settings = {"rtol": rtol, "solver": solver, "attitude": TILTED}
        run = dt.simulate(dt.RotatorReduced(), [0.0, 0.0, speed], ts, **settings)
        errors.append(distance(run.attitude, expected))
        assert np.abs(np.linalg.norm(run.attitude, axis=-1) - 1).max() < 1e-15
        # The dipole lies along the first axis.
        np.testing.assert_allclose(run.dipole, matrix(run.attitude)[..., 0], atol=1e-15)
    assert errors[0] < 1e-4
    assert errors[1] < 1e-9
    assert errors[1] < 1e-3 * errors[0]


@pytest.mark.slow
def test_free_symmetric_top_precesses_about_its_angular_momentum():
    """q = (rotation by Lτ/I₁ about L) ∘ q₀ ∘ (rotation by (1 − I₃/I₁)Ω₃τ about axis 3)."""
    first, third = 1.0, 1.6
    omega0, ts = np.array([0.3, -0.4, 0.9]), np.linspace(0.0, 60.0, 13)
    run = dt.simulate(
        Euler([first, first, third]), omega0, ts, rtol=1e-12, dense=True, attitude=TILTED
    )
    momentum = matrix(TILTED) @ (np.array([first, first, third]) * omega0)
    size = np.linalg.norm(momentum)
    precession = matrix(about(momentum / size, size / first * ts))
    spin = matrix(about([0.0, 0.0, 1.0], (1 - third / first) * omega0[2] * ts))
    assert distance(run.attitude, precession @ matrix(TILTED) @ spin) < 1e-9
    conserved = run.to_laboratory(np.array([first, first, third]) * np.asarray(run.omega))
    np.testing.assert_allclose(conserved, np.tile(momentum, (13, 1)), atol=1e-9)
    np.testing.assert_allclose(run.evaluate(ts[5]), run.omega[5], atol=1e-12)
    with pytest.raises(ValueError, match="`equation` must have a body, but is of type Euler"):
        _ = run.dipole


@eqx.filter_jit
def omega_and_rate(run):
    return run.omega, run.omega_dot


def momentum_defect(equation, start, end, **settings):
    """Change of L − d×d₂ + ∫d₁×d₂ dτ over its size, by Gauss's rule; the change of L − d×d₂."""
    nodes, weights = np.polynomial.legendre.leggauss(COUNT - 2)
    ts = np.concatenate([[0.0], end * (nodes + 1) / 2, [end]])
    run = dt.simulate(equation, start, ts, attitude=TILTED, **settings)
    omega, rate = map(np.asarray, omega_and_rate(run))
    dipole = np.asarray(equation.body.dipole)
    first = np.cross(omega, dipole)
    second = np.cross(omega, first) + np.cross(rate, dipole)
    momentum = omega @ np.asarray(equation.body.inertia) - np.cross(dipole, second)
    held = np.asarray(run.to_laboratory(momentum))
    lost = end / 2 * weights @ np.asarray(run.to_laboratory(np.cross(first, second)))[1:-1]
    size, change = np.linalg.norm(held[0]), held[-1] - held[0]
    return np.abs(change + lost).max() / size, np.abs(change).max() / size


@pytest.mark.slow
def test_full_equation_keeps_the_balance_of_angular_momentum():
    """d/dτ(L − d×d₂) = −d₁×d₂ in the laboratory, along the branch and off it."""
    # Nearly a sphere: it turns much faster than ω changes.
    along, changed = momentum_defect(dt.TransverseFull(-0.02), FIGURE_2A, 150.0, rtol=1e-11)
    assert along < 1e-12
    assert changed > 0.1
    fast = np.cross(GENERIC.dipole, [0.01, -0.02, 0.01])  # across the dipole
    state = np.concatenate([[2.0, 1.0, -1.5], fast])
    few_stages = {"rtol": 1e-12, "solver": diffrax.Tsit5()}
    off, changed = momentum_defect(dt.Full(GENERIC), state, 0.5, **few_stages)
    assert off < 1e-10
    assert changed > 0.01


@pytest.mark.slow
def test_residual_rotation_takes_no_steps_for_its_turns():
    """Figure 2a: after the capture q turns about the dipole by ω∞τ, here some hundred times."""
    given = dt.TransverseFull(-0.2), FIGURE_2A, jnp.linspace(0.0, 5e4, COUNT)
    plain, run = dt.simulate(*given), dt.simulate(*given, attitude=TILTED)
    np.testing.assert_allclose(run.omega, plain.omega, rtol=0, atol=1e-10)
    assert run.stats["num_steps"] == plain.stats["num_steps"]
    assert np.abs(np.linalg.norm(run.attitude, axis=-1) - 1).max() < 1e-15
    middle = COUNT // 2
    angle = float(run.omega[-1, 0] * (run.ts[-1] - run.ts[middle]))
    assert int(run.stats["num_steps"]) < angle / 5
    expected = matrix(run.attitude[middle]) @ matrix(about([1.0, 0.0, 0.0], angle))
    assert distance(run.attitude[-1], expected) < 1e-7


ACROSS = np.array([-0.1, 0.5, 0.5, 0.7])  # a unit quaternion across TILTED


WAY = np.array([1.0, 2.0, -1.0])


@pytest.mark.slow
def test_derivatives_of_the_rotator():
    """By its speed, the time and the first attitude: those of the closed form."""

    def dipole(s, **settings):
        q0, ts = jnp.cos(s) * TILTED + jnp.sin(s) * ACROSS, jnp.array([0.0, 5.0]) * (1 + s)
        settings |= {"rtol": 1e-12, "solver": diffrax.Tsit5(), "attitude": q0}
        start = jnp.array([0.0, 0.0, 0.8]) + s * jnp.array([0.0, 0.0, 1.0])
        return dt.simulate(dt.RotatorReduced(), start, ts, **settings).dipole[-1]

    def expected(s):
        speed = 0.8 + s
        root = np.sqrt(1 + 2 * speed**2 * 5 * (1 + s))
        turn = matrix(about([0.0, 0.0, 1.0], (root - 1) / speed))
        return matrix(np.cos(s) * TILTED + np.sin(s) * ACROSS) @ turn[:, 0]

    exact = difference(expected, 1e-3) @ WAY
    forward = jax.jit(jax.jacfwd(lambda s: dipole(s, adjoint=diffrax.ForwardMode())))(0.0)
    backward = jax.jit(jax.grad(lambda s: dipole(s) @ WAY))(0.0)
    np.testing.assert_allclose([forward @ WAY, backward], exact, rtol=0, atol=3e-9)


@pytest.mark.slow
def test_derivatives_along_the_branch():
    """By shape, start, times and first attitude, against differences of fourth order.

    Reverse mode transposes what forward mode computes, so it alone is compiled.
    """
    start, shift = jnp.array([0.3, 0.2, -0.25]), jnp.array([0.2, -0.5, 0.4])

    def dipole(s):
        q0, ts = jnp.cos(s) * TILTED + jnp.sin(s) * ACROSS, jnp.linspace(0.0, 7.0, COUNT)
        settings = {"rtol": 1e-11, "attitude": q0}
        top = dt.TransverseFull(-0.2 + s)
        return dt.simulate(top, start + s * shift, ts * (1 + s), **settings).dipole[-1]

    exact = difference(lambda s: dipole(jnp.asarray(s)), 1e-3) @ WAY
    slope = jax.jit(jax.grad(lambda s: dipole(s) @ WAY))(jnp.zeros(()))
    np.testing.assert_allclose(slope, exact, rtol=0, atol=3e-8)


@pytest.mark.slow
def test_batch_of_starts_and_of_first_attitudes():
    starts = jnp.asarray(np.random.default_rng(5).normal(size=(3, 3)) / 4)
    attitudes = jnp.array([LEVEL, TILTED])

    def run(start, q0):
        few_stages = {"solver": diffrax.Tsit5(), "attitude": q0}
        return dt.simulate(dt.TransverseReduced(0.3), start, TIMES, **few_stages)

    runs = jax.jit(jax.vmap(jax.vmap(run, (None, 0)), (0, None)))(starts, attitudes)
    assert runs.attitude.shape == (3, 2, 3, 4)
    np.testing.assert_allclose(runs.attitude[:, :, 0], np.tile(attitudes, (3, 1, 1)), atol=1e-15)
    spun = np.einsum("...ij,...j->...i", matrix(runs.attitude), runs.omega)
    np.testing.assert_allclose(runs.to_laboratory(runs.omega), spun, atol=1e-15)
    np.testing.assert_allclose(runs.dipole, matrix(runs.attitude)[..., 0], atol=1e-15)
    # The laboratory may be turned before the motion, or behind it.
    composed = matrix(TILTED) @ matrix(runs.attitude[:, 0])
    assert distance(runs.attitude[:, 1], composed) < 1e-14
    one = jax.tree.map(lambda leaf: leaf[2, 1], runs)
    np.testing.assert_array_equal(one.dipole, runs.dipole[2, 1])
    with pytest.raises(ValueError, match=r"`vectors` must have shape \(3,\) or \(3, 3\), but"):
        one.to_laboratory(jnp.ones((4, 3)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("level", "sentence"),
    [
        (dt.TransverseReduced, r"^The run ended before the last of `ts`: `max_steps` = 5 steps "),
        (dt.TransverseFull, "^The physical branch of the full equation could not be followed "),
    ],
)
def test_what_was_not_reached_is_not_a_number(level, sentence):
    start, ts = jnp.array([0.2, 0.1, 0.2]), jnp.append(jnp.linspace(0.0, 1e-3, COUNT - 1), 1e3)
    settings = {"max_steps": 5, "attitude": TILTED}
    run = dt.simulate(level(-0.2), start, ts, throw=False, **settings)
    np.testing.assert_allclose(run.omega[0], start, rtol=1e-15)
    for reached in (run.omega, run.attitude):
        assert np.all(np.isfinite(reached[:-1]))
        assert np.all(np.isnan(reached[-1]))
    with pytest.raises(RuntimeError, match=sentence + r".*did not suffice\.$"):
        dt.simulate(level(-0.2), start, ts, **settings)


@pytest.mark.slow
def test_a_run_goes_on_from_the_last_attitude_of_another_one():
    top, ts = dt.TransverseReduced(-0.2), np.array([0.0, 6.0, 12.0])
    pulled = dt.torques.field_on_dipole(top, [0.0, 0.1, 0.05])
    equation = dt.torques.with_torque(top, pulled, attitude=TILTED)
    whole = dt.simulate(equation, [0.1, 0.2, 0.1], ts)
    rest = dt.simulate(equation, whole.omega[1], ts[1:], attitude=whole.attitude[1])
    np.testing.assert_allclose(rest.omega[-1], whole.omega[-1], rtol=0, atol=1e-9)
    np.testing.assert_allclose(rest.attitude[-1], whole.attitude[-1], rtol=0, atol=1e-9)


def test_a_traced_bad_attitude_is_not_a_number():
    traced = jax.jit(lambda q0: unit_quaternion("attitude", q0))
    assert jnp.all(jnp.isnan(traced(jnp.zeros(4))))
    np.testing.assert_allclose(traced(TILTED), TILTED, atol=1e-15)


@pytest.mark.slow
def test_an_attitude_that_is_nearly_a_unit_quaternion_is_normalised():
    rotator, ts = (dt.RotatorReduced(), [0.0, 0.0, 1.0]), jnp.linspace(0.0, 1.0, 11)
    run = dt.simulate(*rotator, ts, attitude=TILTED * (1 + 5e-7))
    np.testing.assert_allclose(run.attitude[0], TILTED, rtol=0, atol=1e-15)
    plain = dt.simulate(*rotator, ts)
    for read in (lambda: plain.attitude, lambda: plain.dipole, lambda: plain.to_laboratory([1.0])):
        with pytest.raises(ValueError, match=r"`attitude` must be given to .*, but was"):
            read()
