"""The atlas: means over isotropic L against samples and known values; borders of endings."""

import numpy as np
import pytest

import dipoletop as dt
from dipoletop._averaging.isotropic_ends import (
    isotropic_ends,
    isotropic_shapes,
    momentum_at,
    share_below,
    share_of_side,
)
from dipoletop._averaging.untimed_ends import ends_of_many
from dipoletop._base.directions import spread_directions
from dipoletop.atlases import Ending, cells, saddle_node_border, spin_border

BODIES = np.array([[0.6, 0.75, 1.0], [0.99, 0.995, 1.0], [0.5, 0.55, 1.0], [0.1, 0.95, 1.0]])
ON_1, _, ON_3 = np.eye(3)
# Made apart, by samples of L and another quadrature: hence 0.004, their statistical error.
SAMPLED = 0.004


def _ends(moments, dipole):
    """Always of as many bodies, so that it compiles once."""
    moments = np.resize(moments, (7, 3))
    return isotropic_ends(moments, np.broadcast_to(dipole, moments.shape))


def _mean(moments, function):
    """The mean of a function of h over isotropic L."""
    total = np.zeros(len(moments))
    for ordered in (moments, moments[:, ::-1]):
        nodes, weights = isotropic_shapes(ordered, 16)
        for k, x in enumerate(nodes):
            momentum = momentum_at(ordered, np.full(len(moments), x))
            total += weights[:, k] * function(np.sum(momentum**2 / ordered, axis=1))
    return total


def test_the_quadrature_over_h_is_that_over_directions():
    p = 1 / BODIES
    lune = 2 / np.pi * np.arctan(np.sqrt((p[:, 1] - p[:, 2]) / (p[:, 0] - p[:, 1])))
    np.testing.assert_allclose(share_of_side(BODIES), lune, rtol=1e-13)
    np.testing.assert_allclose(share_of_side(BODIES[:, ::-1]), 1 - lune, rtol=1e-13)
    np.testing.assert_allclose(share_below(BODIES, np.ones(4)), lune, rtol=1e-4)
    # ⟨yᵢ⟩ = 1/3, ⟨yᵢ²⟩ = 1/5, ⟨yᵢyⱼ⟩ = 1/15.
    np.testing.assert_allclose(_mean(BODIES, lambda h: h), np.mean(p, axis=1), rtol=2e-5)
    square = (np.sum(p, axis=1) ** 2 + 2 * np.sum(p**2, axis=1)) / 15
    np.testing.assert_allclose(_mean(BODIES, lambda h: h**2), square, rtol=2e-5)
    h = spread_directions(200_000) ** 2 @ p.T
    inside = np.mean(h < p[:, 2] + 0.4 * (p[:, 1] - p[:, 2]), axis=0)
    np.testing.assert_allclose(share_below(BODIES, np.full(4, 0.4)), inside, atol=1e-4)


@pytest.mark.slow
def test_nearly_spherical_bodies_depend_on_the_splitting_alone():
    splitting = np.array([0.01, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99])
    one = np.ones(7)
    moments = np.stack([one - 1e-6, one - 1e-6 * (1 - splitting), one], axis=1)
    known = [0.503, 0.501, 0.491, 0.469, 0.427, 0.328, 0.158]
    found = _ends(moments, ON_3).ratio
    np.testing.assert_allclose(found, known, atol=SAMPLED)
    # Without splitting L₃ is what is left, with the mean 1/2.
    assert found[0] == pytest.approx(0.5, abs=1e-4)
    mirrored = np.stack([one - 1e-6, one - 1e-6 * splitting, one], axis=1)
    np.testing.assert_allclose(_ends(mirrored, ON_1).ratio, found, rtol=1e-5)


@pytest.mark.slow
def test_the_particles_of_the_paper():
    moments = [[0.99, 0.995], [0.616, 0.634], [0.622, 0.628], [0.0199, 0.9974], [0.97, 0.985]]
    moments = np.array([[*pair, 1.0] for pair in moments])
    on_1, on_2, on_3 = (_ends(moments, axis) for axis in np.eye(3))
    np.testing.assert_allclose(on_1.ratio[:5], [0.465, 0.124, 0.072, 0.500, 0.464], atol=SAMPLED)
    np.testing.assert_allclose(on_3.ratio[:5], [0.470, 0.503, 0.503, 0.711, 0.471], atol=SAMPLED)
    residual = np.sum(on_1.probability[:, :2], axis=1)
    np.testing.assert_allclose(residual[:5], [1, 1, 0.23, 1, 1], atol=0.005)
    np.testing.assert_array_equal(on_2.ratio, 0)
    np.testing.assert_allclose(np.sum(on_2.probability[:, 2:], axis=1), 1, rtol=1e-12)


@pytest.mark.slow
def test_means_are_those_of_single_ends():
    """A dipole in a generic direction, with two kinds of stop; and one on the axis of J₁."""
    moments, momenta = np.array([0.5, 0.55, 1.0]), spread_directions(100)
    inertia = np.tile(np.diag(moments), (100, 1, 1))
    for dipole in ([0.95, 0.05, 0.309], [1.0, 0.0, 0.0]):
        sample = ends_of_many(inertia, np.tile(dipole, (100, 1)), 1e-20 * momenta / moments)
        found = _ends(moments, dipole)
        probability = np.mean(sample.probability, axis=0)
        probability[:2] = np.mean(probability[:2])
        assert np.sum(probability > 0) >= 2
        np.testing.assert_allclose(found.probability[0], probability, atol=0.02)
        assert found.ratio[0] == pytest.approx(np.mean(sample.ratio), abs=0.01)


def test_borders_have_their_known_places():
    known = {0.39: 0.61423237, 0.50: 0.60550456, 0.62: 0.63283049, 0.665: 0.66502118}
    found = saddle_node_border(np.array(list(known)))
    np.testing.assert_allclose(found, list(known.values()), atol=3e-6)
    assert np.all(np.isnan(saddle_node_border(np.array([0.2, 0.3848, 0.667, 0.9]))))
    # It begins at 0.384832, on the line of discs.
    (beside,) = saddle_node_border(np.array([0.38485]))
    assert 0 < beside - (1 - 0.38485) < 3e-5
    j1 = np.linspace(0.1, 0.4, 7)
    j2 = spin_border(j1)
    np.testing.assert_allclose(j2 * j1**2, (1 - j2) * (1 - j1) ** 2, rtol=1e-13)


@pytest.mark.slow
def test_maps_agree_with_the_borders():
    first, second, third = (dt.atlas(axis, n=8) for axis in (1, 2, 3))
    assert set(third.ending) == {Ending.RESIDUAL}
    j1, j2, _ = second.moments.T
    expected = np.where(j2 < spin_border(j1), Ending.SPIN_3, Ending.TUMBLING_LOW)
    np.testing.assert_array_equal(second.ending, expected)
    # NaN compares false: there is no border at that J₁/J₃.
    below = first.moments[:, 1] < saddle_node_border(first.moments[:, 0])
    inside = (first.moments[:, 0] > 0.384832) & (first.moments[:, 0] < 2 / 3)
    np.testing.assert_array_equal(first.ending == Ending.BOTH, below & inside)
    assert np.mean(below) == pytest.approx(0.05, abs=0.015)
    assert np.all((first.residual > 0) & (first.residual <= 1 + 1e-12))
    assert "64 bodies with the dipole on axis 1; RESIDUAL 0.9" in repr(first)


@pytest.mark.slow
def test_a_map_over_dipoles_stops_everywhere():
    grain = dt.Particle.cuboid([1e-7, 6e-8, 4e-8], [0, 0, 8e-27], density=2000)
    found = dt.atlas(body=grain, n=4)
    assert found.dipole_axis is None
    np.testing.assert_allclose(np.sum(found.probability, axis=1), 1, rtol=1e-12)
    np.testing.assert_array_equal(found.residual, 0)
    np.testing.assert_allclose(np.sum(found.dipole**2, axis=1), 1, rtol=1e-13)
    # Next to the corner of J₃ its axis attracts every motion.
    assert found.ending[np.argmax(found.dipole[:, 2])] == Ending.SPIN_3
    names = ",".join(found.columns())
    assert names == "J1,J2,J3,n1,n2,n3,ending,residual,ratio,error"


def test_cells_cover_the_triangle_once():
    corners = cells(5)
    np.testing.assert_allclose(np.sum(corners, axis=2), 1)
    areas = np.abs(np.linalg.det(corners))  # in units of the whole triangle
    np.testing.assert_allclose(areas, 1 / 25)
    assert len({tuple(middle) for middle in np.mean(corners, axis=1).round(9).tolist()}) == 25
