"""Refined maps against pictures known in closed form, and against whole sweeps of the top."""

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest

import dipoletop as dt
from dipoletop import Fate, Outcome, adaptive
from dipoletop._maps.sweep import PointSweeps
from dipoletop.adaptive import refine
from dipoletop.boundary import fate

SIDE = np.linspace(0.0, 1.0, 128)
GRID = dt.Grid(x=SIDE, y=SIDE)
PLANE = np.meshgrid(SIDE, SIDE, indexing="ij")


def painted(value):
    """Tops whose fate is known: ω∞ = value about the dipole; 1 and more turns, −1 and less not."""
    about = value * jnp.array([1.0, 0.0, 0.0])
    start = jnp.where(value < 1.0, about, jnp.array([0.01, 0.02, 0.5]))
    start = jnp.where(value > -1.0, start, jnp.array([0.0, 0.2, 0.0]))
    return dt.TransverseReduced(-0.2), start


def fates(value):
    """The same by definition."""
    stops = [value >= 1, value <= -1]
    return np.select(
        stops, [Fate.ROTATING, Fate.AXIS], np.where(value > 0, Fate.POSITIVE, Fate.NEGATIVE)
    )


def bilinear(x, y):
    return 0.1 + 0.2 * x + 0.1 * y + 0.4 * x * y


def scene(x, y, xp=jnp):
    """Both signs of ω∞ with a wavy border; a disc with a core; a tongue two points thin from it."""
    value = xp.where(y > 0.6 + 0.1 * xp.sin(9.0 * x), bilinear(x, y), -bilinear(x, y))
    tongue = (xp.abs(y - 0.31 - 0.03 * xp.sin(11.0 * x)) < 0.007) & (xp.abs(x - 0.6) < 0.3)
    away = xp.hypot(x - 0.3, y - 0.31)
    value = xp.where((away < 0.13) | tongue, 2.0, value)
    return xp.where(away < 0.06, -2.0, value)


def problem_of(values):
    """The problem of tops with these values."""
    return jax.jit(lambda x, y: painted(values(x, y)))


@pytest.fixture(scope="module")
def refined():
    """The map of the picture, and the points that were integrated for it."""
    visited = []

    class Watched(PointSweeps):
        def __call__(self, points, derivatives=()):
            visited.append(np.stack([points.columns["x"], points.columns["y"]], -1))
            return super().__call__(points, derivatives)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(adaptive, "PointSweeps", Watched)
        found = refine(problem_of(scene), GRID, coarse=16)
    return found, np.concatenate(visited)


def test_the_picture_is_right(refined):
    found, value = refined[0], scene(*PLANE, np)
    assert np.array_equal(fate(found), fates(value))
    assert set(np.unique(fate(found))) == {Fate.POSITIVE, Fate.NEGATIVE, Fate.ROTATING, Fate.AXIS}
    # ω∞ is bilinear in this picture, so that nothing is lost by what is filled in.
    omega = np.where(np.abs(value) < 1, value, 0)
    assert np.max(np.abs(found.omega_inf - omega)) < 1e-15
    assert np.all(found.certified)
    dt.plots.basin(found)
    plt.close("all")


def test_few_points_are_integrated_and_none_twice(refined):
    found, points = refined
    computed = found.column("computed")
    assert np.mean(computed) < 0.25
    assert np.all(found.steps[~computed] == 0)
    assert len(np.unique(points, axis=0)) == len(points) == found.attrs["computed"]
    assert np.array_equal(np.unique(np.rint(127 * points), axis=0), np.argwhere(computed))


def test_a_thin_tongue_is_followed_from_cell_to_cell(refined):
    """Of width two points in cells of four: no corner falls into most of it."""
    along = np.flatnonzero((SIDE > 0.45) & (SIDE < 0.9))
    rows = np.rint(127 * (0.31 + 0.03 * np.sin(11 * SIDE[along]))).astype(int)
    assert np.all(refined[0].column("computed")[along, rows])


def test_what_is_documented_as_missed_is_missed_and_a_finer_lattice_finds_it():
    def island(x, y, xp=jnp):
        return xp.where(xp.hypot(x - 0.53, y - 0.28) < 0.02, 2.0, bilinear(x, y))

    problem, value = problem_of(island), island(*PLANE, np)
    assert np.sum(value > 1) > 10
    assert np.all(refine(problem, GRID, coarse=8).outcome == Outcome.RESIDUAL)
    assert np.array_equal(fate(refine(problem, GRID, coarse=31)), fates(value))


def test_uneven_axes_of_different_lengths_among_axes_of_length_one():
    """Rows and columns are split as their own lengths ask for; ω∞ is linear in their values."""

    def values(x, y, xp=jnp):
        return xp.where(x + y > 0.4, 1.0, -1.0) * bilinear(x, y)

    @jax.jit
    def problem(shift, x, way, y):
        return painted(values(x, y + shift) * way[2])

    x, y = np.geomspace(0.01, 1.0, 150), np.linspace(0.0, 0.9, 37) ** 3
    found = refine(problem, dt.Grid(shift=0.0, x=x, way=[[0.0, 0.0, 0.5]], y=y), coarse=9)
    assert found.dims == ("shift", "x", "way", "y")
    assert found.shape == (1, 150, 1, 37)
    assert found.attrs["refined_from"] == [16, 4]
    assert np.mean(found.column("computed")) < 0.3
    value = values(*np.meshgrid(x, y, indexing="ij"), np) / 2
    assert np.max(np.abs(found.omega_inf[0, :, 0] - value)) < 1e-15


def test_cells_are_halved_until_the_interpolated_value_is_good_enough():
    def waves(x, y, xp=jnp):
        return 0.5 + 0.3 * xp.sin(8.0 * x * x) * xp.cos(5.0 * y)

    problem, value = problem_of(waves), waves(*PLANE, np)
    rough, good = (refine(problem, GRID, coarse=8, omega_tol=tol) for tol in (None, 4e-3))
    errors = [np.max(np.abs(found.omega_inf - value)) for found in (rough, good)]
    assert errors[0] > 0.02
    computed = good.column("computed")
    assert np.max(np.abs(good.omega_inf - value)[computed]) < 1e-15
    assert errors[1] < 8e-3  # in the middle of every cell it is below 4e-3
    assert rough.attrs["computed"] < good.attrs["computed"] < 0.3 * value.size


def test_basins_of_the_top():
    @jax.jit
    def problem(delta, w3, phi):
        return dt.TransverseReduced(delta), dt.cylindrical(0.2, w3, phi)

    w3, phi = np.linspace(0.01, 0.5, 63), np.linspace(0.0, np.pi, 64)
    found = refine(problem, dt.Grid(delta=-0.2, w3=w3, phi=phi), coarse=15, rtol=1e-7)
    every = [values.ravel() for values in np.meshgrid(w3, phi, indexing="ij")]
    labels = []
    for part in np.split(np.arange(63 * 64), 4):  # as many as are refined at once: see PARTS
        points = dt.Points(delta=np.full(1008, -0.2), w3=every[0][part], phi=every[1][part])
        labels.append(fate(dt.sweep(problem, points, rtol=1e-7)))
    assert set(np.unique(labels)) == {Fate.POSITIVE, Fate.NEGATIVE, Fate.ROTATING}
    assert np.array_equal(fate(found)[0], np.concatenate(labels).reshape(63, 64))
    assert np.mean(found.column("computed")) < 0.6
    assert found.level == "reduced, order 1 (the paper's)"
    assert found.attrs["rtol"] == 1e-7
