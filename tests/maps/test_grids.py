"""Grids, points and samples."""

import jax.numpy as jnp
import numpy as np
import pytest

import dipoletop as dt


def test_sample_depends_on_seed_and_number_only():
    long, short = dt.Sample(n=100, seed=3), dt.Sample(n=10, seed=3)
    assert np.array_equal(long.points(np.arange(10)), short.points(np.arange(10)))
    assert np.array_equal(long.points(np.array([7])), short.points(np.arange(10))[7:8])
    assert not np.array_equal(
        long.points(np.arange(10)), dt.Sample(n=10, seed=4).points(np.arange(10))
    )


def test_starts_beyond_32_bits_are_new_ones():
    """Those before are what they always were."""
    large, small = dt.Sample(n=10**12, seed=3), dt.Sample(n=10, seed=3)
    first = np.asarray(large.points(np.arange(4)))
    np.testing.assert_array_equal(first, small.points(np.arange(4)))
    mixed = np.asarray(large.points(np.array([0, 3, 2**32, 2**32 + 3, 2 * 2**32, 10**12 - 1])))
    np.testing.assert_array_equal(mixed[:2], first[[0, 3]])
    assert len(np.unique(mixed[:, 0])) == len(mixed)
    assert jnp.allclose(jnp.linalg.norm(mixed, axis=1), 1.0)


def test_isotropic_starts_are_isotropic():
    w = np.asarray(dt.Sample(n=20_000, amplitude=0.2, seed=0).points(np.arange(20_000)))
    assert np.allclose(np.linalg.norm(w, axis=1), 0.2, rtol=1e-14)
    assert np.all(np.abs(w.mean(0)) < 4 * 0.2 / np.sqrt(3 * 20_000))
    assert np.allclose(np.cov(w.T) / 0.04 * 3, np.eye(3), atol=0.05)
    sizes = np.linalg.norm(dt.Sample(n=5000, amplitude=(1e-3, 1.0)).points(np.arange(5000)), axis=1)
    assert abs(np.log(sizes).mean() - np.log(1e-3) / 2) < 0.15
    box = np.asarray(
        dt.Sample(n=500, draw=dt.uniform_box([0, 1, 2], [1, 2, 4])).points(np.arange(500))
    )
    assert np.all((box >= [0, 1, 2]) & (box <= [1, 2, 4]))


def test_symmetry_cell():
    grid = dt.symmetry_cell(n_phi=8, n_w3=5, w3_max=0.4)
    assert grid.shape == (5, 8)
    assert grid.axes["phi"][-1] == np.pi * 7 / 8
    assert grid.axes["w3"][-1] == 0.4


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: dt.Grid(), "`axes` must name at least one axis"),
        (lambda: dt.Grid(w3=[]), "`w3` must hold at least one value"),
        (lambda: dt.Grid(w3=[0.1, np.nan]), "`w3` must be finite"),
        (lambda: dt.Grid(w3=["a"]), "`w3` must be a real array"),
        (lambda: dt.Sample(n=0), "`n` must be a positive whole number, but is 0"),
        (lambda: dt.Sample(n=5, amplitude=-1.0), "`amplitude` must be positive, or a pair"),
        (lambda: dt.Sample(n=5, amplitude=(1.0, 0.1)), "`amplitude` must be positive, or a pair"),
    ],
)
def test_bad_input_is_refused_in_one_sentence(call, message):
    with pytest.raises(ValueError, match=message):
        call()


@pytest.mark.parametrize(
    ("points", "printed"),
    [
        (
            dt.Grid(delta=-0.2, w3=np.linspace(0, 0.5, 201), phi=np.linspace(0, np.pi, 256)),
            "Grid(delta: -0.2, w3: 201 values in [0, 0.5], phi: 256 values in [0, 3.142]; "
            "51 456 starts)",
        ),
        (dt.Grid(omega=np.eye(3)), "Grid(omega: 3 vectors of shape (3,); 3 starts)"),
        (dt.Points(w3=[0.1], phi=[2.0]), "Points(w3: 0.1, phi: 2; 1 start)"),
        (dt.Sample(n=5, amplitude=(0.1, 1), seed=3), "Sample(n=5, amplitude=(0.1, 1), seed=3)"),
    ],
)
def test_points_print_their_numbers(points, printed):
    assert repr(points) == printed
