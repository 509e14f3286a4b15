"""What a body does is the same in whatever axes it is written, up to the error that is stated."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import dipoletop as dt
from dipoletop.stability import equilibria

SPLITTINGS = 10.0 ** -np.arange(1, 13)
DIPOLES = {
    "axis 1": [1, 0, 0],
    "axis 2": [0, 1, 0],
    "axis 3": [0, 0, 1],
    "oblique": [0.2, 0.5, 0.8],
}
START = 1e-20 * np.array([0.7, -0.5, 0.4])


def turned(q, inertia, *vectors):
    whole = q @ inertia @ q.T
    return (whole + whole.T) / 2, *(q @ vector for vector in vectors)


def frames(count, seed=3):
    """Permutations of the axes with signs, and turned axes."""
    rng = np.random.default_rng(seed)
    cyclic = np.eye(3)[[1, 2, 0]]
    return [
        cyclic,
        np.diag([1.0, -1.0, -1.0]) @ cyclic.T,
        *Rotation.random(count, rng=rng).as_matrix(),
    ]


def assert_same(found, known):
    error = 3 * max(float(known.error), float(found.error)) + 1e-10
    assert found.outcome == known.outcome
    np.testing.assert_allclose(found.probability, known.probability, rtol=0, atol=error)
    np.testing.assert_allclose(found.ratio, known.ratio, rtol=error, atol=0)
    np.testing.assert_allclose(found.half_time, known.half_time, rtol=error)


@pytest.mark.slow
@pytest.mark.parametrize("dipole", DIPOLES)
@pytest.mark.parametrize("nearly", ["oblate", "prolate"])
def test_a_prediction(nearly, dipole):
    for splitting in SPLITTINGS:
        pair = [0.6, 0.6 * (1 + splitting), 1.0]
        moments = pair if nearly == "oblate" else [0.6, 1 - splitting, 1.0]
        given = np.diag(moments), np.array(DIPOLES[dipole], float), START
        inertia, n, omega = given
        known = dt.predict(dt.Body(inertia, n), omega)
        assert (known.outcome == dt.Outcome.STOP) or dipole != "oblique"
        for q in frames(2):
            inertia, n, omega = turned(q, *given)
            assert_same(dt.predict(dt.Body(inertia, n), omega), known)


@pytest.mark.slow
def test_a_residual_rotation_in_turned_axes():
    """A dipole on a principal axis, to rounding: L∞/L₀ is that in the principal axes."""
    inertia = np.array(
        [
            [0.8289128611900348, -0.21730295783805206, -0.1261245115316091],
            [-0.21730295783805206, 0.5761568223694492, -0.2297074036041516],
            [-0.1261245115316091, -0.2297074036041516, 0.8206303164405163],
        ]
    )
    body = dt.Body(inertia, [0.3435805982503526, -0.6177917462347519, 0.7073087945092624])
    start = [-3.5911395658384354e-05, -6.547228661103014e-05, -6.65112873713184e-05]
    found = dt.predict(body, start)
    assert found.outcome == dt.Outcome.RESIDUAL
    assert abs(float(found.ratio) - 0.219741) < 5e-7
    assert dt.classify_many(dt.SemiReduced(body), [start]).outcome[0] == dt.Outcome.RESIDUAL


@pytest.mark.slow
def test_a_grain_in_turned_axes():
    grain = dt.Particle.cuboid([100e-9, 99.9e-9, 60e-9], [8e-27, 0, 0], density=2000)
    momentum = np.array([1.0, 0.1, 0.05])
    for q in (np.eye(3), *frames(3)):
        inertia, dipole, along = turned(q, np.asarray(grain.inertia), grain.dipole, momentum)
        here = dt.Particle(grain.mass, inertia, dipole)
        found = dt.predict(here, dt.particles.start(here, "1 GHz", momentum=along))
        assert float(found.ratio) == pytest.approx(0.71148233658, abs=1e-10)


@pytest.mark.slow
def test_labels_of_many_in_turned_axes():
    given = np.diag([1.0, 1.01, 1.3]), np.array([1.0, 0, 0]), 1e-12 * np.array([0.6, 0.64, 0.48])
    bodies = [turned(q, *given) for q in (np.eye(3), *frames(6))]
    inertia, dipole, starts = (np.stack(values) for values in zip(*bodies, strict=True))
    found = dt.classify_many(dt.SemiReduced(dt.Body(inertia, dipole)), starts)
    np.testing.assert_array_equal(found.outcome, dt.Outcome.RESIDUAL)
    sizes = np.abs(found.omega_inf)
    np.testing.assert_allclose(sizes, sizes[0], rtol=1e-9)


@pytest.mark.parametrize("delta", [pytest.param(0.5, marks=pytest.mark.slow), -0.5])
@pytest.mark.parametrize("start", [(1.0, 0.0, 0.0), (0.6, 0.8, 0.0)])
def test_rotation_end_over_end(delta, start):
    """E falls by half in 1/(2ω²) if the dipole lies along the axis, (2.4); else it is tipped."""
    omega, inertia = 1e-20 * np.array(start), np.diag([1.0, 1.0, 1 - delta])
    for q in (np.eye(3), *frames(2)):
        turned_inertia, axis, here = turned(q, inertia, np.array([0.0, 0.0, 1.0]), omega)
        found = dt.predict(dt.Body(turned_inertia, axis), here)
        assert found.outcome == dt.Outcome.STOP
        assert float(found.half_time) == pytest.approx(5e39, rel=1e-12)
    oblique = dt.Body(inertia, [0.6, 0.0, 0.8])
    ends = [dt.predict(oblique, w) for w in (omega, omega + np.array([0.0, 0.0, 1e-24]))]
    assert all(end.outcome == dt.Outcome.STOP for end in ends)
    # While it precesses, n·Ω/|Ω| is 0.6 times a cosine.
    assert [float(end.half_time) for end in ends] == pytest.approx([5e39 / 0.82] * 2, rel=1e-7)
    assert float(ends[0].error) < 1e-7


@pytest.mark.parametrize("lean", [1e-12, 1e-11])
def test_a_prediction_and_an_equilibrium_need_the_same_principal_axis(lean):
    """|n × In| is 0.4e-12 or 4e-12 here; 4096 roundings of tr I are 2.2e-12."""
    body = dt.Body(np.diag([0.6, 0.8, 1.0]), [lean, 0.0, 1.0])
    keeps = not np.isnan(equilibria(dt.Full(body)).direction).any()
    found = dt.predict(body, START)
    assert keeps == (lean < 5e-12) == bool(found.outcome == dt.Outcome.RESIDUAL)
    assert not keeps or float(found.error) >= lean


@pytest.mark.slow
@pytest.mark.parametrize("dipole", DIPOLES)
def test_lines(dipole):
    """Their total power, and the frequencies and powers of the strongest."""
    for splitting in SPLITTINGS[::3]:
        inertia = np.diag([0.6, 0.6 * (1 + splitting), 1.0])
        given = inertia, np.array(DIPOLES[dipole], float), 1e20 * START
        known = dt.lines(dt.Body(*given[:2]), given[2])
        for q in frames(2):
            turned_inertia, n, omega = turned(q, *given)
            found = dt.lines(dt.Body(turned_inertia, n), omega)
            np.testing.assert_allclose(found.total, known.total, rtol=1e-9)
            for each in (lambda one: one.power, lambda one: one.frequency * one.power):
                sums = [float(np.sum(each(one))) for one in (known, found)]
                assert sums[0] == pytest.approx(sums[1], rel=1e-9)


@pytest.mark.slow
def test_a_spectrum():
    for splitting in SPLITTINGS[::3]:
        inertia, n = np.diag([0.6, 0.6 * (1 + splitting), 1.0]), np.array([1.0, 0.0, 0.0])
        known = dt.spectrum(dt.SemiReduced(dt.Body(inertia, n)), 0.01 * n)
        for q in frames(2):
            turned_inertia, m = turned(q, inertia, n)
            found = dt.spectrum(dt.SemiReduced(dt.Body(turned_inertia, m)), 0.01 * m)
            np.testing.assert_allclose(found.slow, known.slow, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("moments", "dipole", "momentum", "most"),
    [
        ([1e-8, 1.0, 1.0], [1, 0, 0], [0.3, 0.5, 0.8], 1e-5),
        ([0.12, 0.88, 1.0], [1, 0, 0], [1e-11, 1e-11, 1.0], 1e-2),
        ([0.5, 0.75, 1.0], [1e-9, 1e-9, 1.0], [0, 0, 1.0], 1e-4),
        ([0.5, 0.5 * (1 + 1e-13), 1.0], [7e-4, -1.3e-3, 1.0], [0.1, 0.7, 0.5], 0.2),
        ([0.6, 1 - 1e-9, 1.0], [0, 0, 1], [0.3, 0.5, 0.8], 1e-5),
    ],
    ids=["thin rod", "start next to an axis", "dipole next to an axis", "nearly oblate", "prolate"],
)
def test_the_stated_error_is_not_smaller_than_that_by_rounding(moments, dipole, momentum, most):
    inertia, n = np.diag(moments), np.array(dipole, float)
    given = inertia, n, 1e-25 * np.array(momentum) / moments
    known = dt.predict(dt.Body(inertia, n), given[2])
    for q in frames(6)[2:]:
        inertia, n, omega = turned(q, *given)
        found = dt.predict(dt.Body(inertia, n), omega)
        assert found.outcome == known.outcome
        assert 1e-12 < found.error < most
        for name in ("ratio", "half_time"):
            near = pytest.approx(float(getattr(known, name)), rel=float(found.error), abs=0)
            assert float(getattr(found, name)) == near


def test_a_dipole_that_is_along_its_axis_to_rounding_of_its_length_only():
    """It is off the axis, so the rotation end over end tips and stops about the long axis."""
    given = np.diag([1.0, 1.0, 2e-5]), np.array([0, 2e-12, 1.0]), np.array([0, 1e-22, 0])
    for q in (np.eye(3), *frames(3)):
        inertia, n, omega = turned(q, *given)
        found = dt.predict(dt.Body(inertia, n), omega)
        assert found.outcome == dt.Outcome.STOP
        assert found.probability[2] == 1
