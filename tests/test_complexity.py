"""Entropies, dimensions and exponents of sets whose own are known in closed form."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dipoletop as dt
from dipoletop import complexity
from dipoletop.complexity import basin_entropy, boundary_dimension, uncertainty_exponent


def entropy(*shares):
    return -sum(p * np.log(p) for p in shares)


def cantor(k):
    """The middle-third set, to 3^k points."""
    row = np.ones(1, int)
    for _ in range(k):
        row = np.concatenate([row, 0 * row, row])
    return row


def carpet(k):
    """Sierpinski's, to 3^k × 3^k points."""
    square = np.ones((1, 1), int)
    for _ in range(k):
        square = np.block([[square] * 3, [square, 0 * square, square], [square] * 3])
    return square


PLACES = np.arange(1024.0)
DISC = np.hypot(PLACES[:, None] - 500.3, PLACES - 511.7) < 300.2
LINE = 0.377 * PLACES[:, None] + 100.1 < 0.61 * PLACES


def test_entropy_of_a_straight_border():
    """Columns 0–41 and 42–99 of 100: in boxes of ten the border leaves 2 columns of 10."""
    labels = np.broadcast_to(np.arange(100) < 42, (100, 100))
    found = basin_entropy(labels, box=10)
    assert (found.boxes, found.boundary_boxes) == (100, 10)
    assert np.isclose(found.boundary_entropy, entropy(0.2, 0.8), rtol=1e-14)
    assert np.isclose(found.entropy, entropy(0.2, 0.8) / 10, rtol=1e-14)
    assert found.boundary_error < 1e-15
    # Ten of a hundred boxes have the one value, the others 0.
    assert np.isclose(found.error, entropy(0.2, 0.8) * np.sqrt(0.1 * 0.9 / 99), rtol=1e-12)


def test_entropy_of_carpets_noise_and_a_single_basin():
    found = basin_entropy(carpet(5), box=3)
    assert (found.boxes, found.boundary_boxes) == (9**4, 8**4)
    assert np.isclose(found.boundary_entropy, entropy(1 / 9, 8 / 9), rtol=1e-12)
    # Four colours at random in large boxes: ln 4, but for (4 − 1)/(2 · 1600) by the finite box.
    noise = basin_entropy(np.random.default_rng(1).integers(-3, 1, (800, 800)), box=40)
    assert abs(noise.entropy - (np.log(4) - 3 / 3200)) < 4 * noise.error < 1e-3
    assert noise.boundary_entropy == noise.entropy > np.log(2)
    alone = basin_entropy(np.full((20, 20), 7))
    assert (alone.entropy, alone.error, alone.boundary_boxes) == (0.0, 0.0, 0)
    assert np.isnan(alone.boundary_entropy)
    assert np.isnan(alone.boundary_error)


def test_rows_and_columns_that_fill_no_box_are_left_out():
    labels = np.zeros((11, 17), int)
    labels[10, :], labels[:, 15:] = 1, 2
    found = basin_entropy(labels)
    assert (found.boxes, found.entropy) == (6, 0.0)


@pytest.mark.parametrize("labels", [DISC, LINE], ids=["circle", "line"])
def test_smooth_boundaries(labels):
    """Dimension 1, and an entropy that grows as the side of the boxes (α = 1)."""
    found = boundary_dimension(labels)
    assert abs(found.dimension - 1) < 3 * found.error < 0.02
    small, large = (basin_entropy(labels, box=side).entropy for side in (8, 32))
    assert abs(np.log(large / small) / np.log(4) - 1) < 0.03


def test_dimension_of_cantor_stripes_is_exact():
    """1 + ln 2/ln 3: every interval of 3^j points has its own box, and the gap before it one."""
    sides = 3 ** np.arange(6)
    row = np.concatenate([np.zeros(3**7, int), cantor(7), np.zeros(3**7, int)])
    found = boundary_dimension(np.broadcast_to(row, (3**5 + 1, len(row))), scales=sides)
    assert np.array_equal(found.counts, 2 ** (8 - np.arange(6)) * 3 ** (5 - np.arange(6)))
    assert np.isclose(found.dimension, 1 + np.log(2) / np.log(3), rtol=1e-12)
    assert found.error < 1e-12
    assert found.scales.tolist() == sides.tolist()


def test_dimension_of_the_carpet():
    found = boundary_dimension(carpet(6), scales=3 ** np.arange(1, 6))
    assert abs(found.dimension - np.log(8) / np.log(3)) < 0.03
    line, cov = np.polyfit(-np.log(found.scales), np.log(found.counts), 1, cov=True)
    assert np.isclose(found.dimension, line[0], rtol=1e-10)
    assert np.isclose(found.error, np.sqrt(cov[0, 0]), rtol=1e-9)


TOP = dt.TransverseReduced(-0.2)


def order(x, xp):
    """In which gap of the Cantor set x lies: 1 if one of odd order, −1 if even, 0 if none yet."""
    value, parity = xp.zeros_like(x), 1.0
    for _ in range(18):
        digit = xp.floor(3 * x)
        value = xp.where((digit == 1.0) & (value == 0.0), parity, value)
        x, parity = 3 * x - digit, -parity
    return value


@jax.jit
def stripes(x, y, turn):
    """Tops about the dipole, one way round in one kind of gap, the other way in the other."""
    return TOP, turn * order(x, jnp) * jnp.array([1.0, 0.0, 0.0])


def test_exponent_of_cantor_stripes():
    """α = 1 − ln 2/ln 3; in steps of 3 nothing oscillates about the law, but for the ends of x."""
    region = dt.Grid(x=[0.0, 1.0], y=[-1.0, 1.0], turn=0.5)
    steps = 0.4 / 3.0 ** np.arange(5, 11)
    found = uncertainty_exponent(stripes, region, epsilons=steps, n=2700, along="x", seed=3)
    assert abs(found.exponent - (1 - np.log(2) / np.log(3))) < 3 * found.error < 0.06
    assert found.dimension == 2 - found.exponent
    # The same share of many more points, labelled without any sweep.
    moved = np.random.default_rng(0).random(200_000) + steps[:, None, None] * np.array(
        [[-1], [0], [1]]
    )
    share = np.mean(np.ptp(order(moved, np), axis=1) > 0, axis=1)
    assert np.all(np.abs(found.fractions - share) < 4 * found.fraction_errors)
    # The same line by numpy.
    wide = found.fractions / found.fraction_errors
    line, cov = np.polyfit(np.log(steps), np.log(found.fractions), 1, w=wide, cov="unscaled")
    assert np.isclose(found.exponent, line[0], rtol=1e-10)
    assert np.isclose(found.error, np.sqrt(cov[0, 0]), rtol=1e-10)
    assert np.allclose(found.fraction_errors**2 * 2700, found.fractions * (1 - found.fractions))
    # Across the stripes nothing is uncertain, and so there is no law.
    with pytest.raises(ValueError, match="some points uncertain and others not, but 0 of 2700"):
        uncertainty_exponent(stripes, region, epsilons=steps, n=2700, along="y")


def test_boundaries_of_the_top_are_smooth():
    """α = 1, and by box counting dimension 1; a basin is as good as its labels."""

    @jax.jit
    def problem(w3, phi):
        return TOP, dt.cylindrical(0.2, w3, phi)

    region = dt.Grid(w3=[0.05, 0.4], phi=[0.1, 1.5])
    steps = np.geomspace(0.003, 0.05, 6)
    found = uncertainty_exponent(problem, region, epsilons=steps, n=2700)
    assert abs(found.exponent - 1) < 3 * found.error < 0.25
    assert found.dimension == 2 - found.exponent
    again = uncertainty_exponent(problem, region, epsilons=steps, n=2700, along="phi")
    assert np.array_equal(again.fractions, found.fractions)

    # As many points as above, so that nothing is compiled again.
    grid = dt.Grid(w3=np.linspace(0.05, 0.4, 216), phi=np.linspace(0.1, 1.5, 225))
    basin = dt.sweep(problem, grid)
    assert abs(boundary_dimension(basin).dimension - 1) < 0.05
    in_disorder = basin.isel(
        w3=np.random.default_rng(0).permutation(216), phi=slice(None, None, -1)
    )
    assert boundary_dimension(in_disorder).dimension == boundary_dimension(basin).dimension
    labels = np.sign(basin.omega_inf).astype(int)
    assert basin_entropy(basin) == basin_entropy(labels)


def test_results_show_their_numbers():
    steps, shares = np.array([0.01, 0.1]), np.array([0.02, 0.2])
    assert repr(complexity.UncertaintyExponent(0.98, 0.02, 1.02, steps, shares, shares / 10)) == (
        "UncertaintyExponent(exponent=0.98 ± 0.02, dimension=1.02, epsilons=[0.01, 0.1], "
        "fractions=[0.02, 0.2])"
    )
    assert repr(basin_entropy(np.zeros((10, 10), int))).startswith("BasinEntropy(entropy=0 ± 0")
    straight = boundary_dimension(np.arange(65)[:, None] < np.full(65, 20))
    assert repr(straight).endswith("scales=[1, 2, 4], counts=[64, 32, 16])")
