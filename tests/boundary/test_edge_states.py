"""The edge state against the saddle of the planar system."""

import numpy as np
import pytest
from slow_tops import DELTA

import dipoletop as dt
from dipoletop import boundary
from dipoletop.planar import Planar, saddle


def test_the_edge_state_is_the_saddle():
    a, b = dt.cylindrical(0.1, 0.0, 0.0), dt.cylindrical(0.1, 0.1, 0.0)
    edge = boundary.edge_state(dt.TransverseReduced(DELTA), a, b, shape_tol=1e-3)
    assert edge.settled
    at = saddle(Planar(DELTA, corrected=False))
    u = np.sum(edge.omega[:, :2] ** 2, axis=1)
    error = np.abs(edge.shape - np.array([float(at.phi), float(at.z)]))
    assert np.all(error[-1] < np.minimum(20 * u[-1], 1e-3))
    assert np.all(edge.width < 1e-8)


def test_bad_input_is_one_sentence():
    start, equation = np.array([0.2, 0.0, 0.1]), dt.TransverseReduced(DELTA)
    with pytest.raises(ValueError, match="`shape_tol` must lie between"):
        boundary.edge_state(equation, start, start, shape_tol=-1.0)
    with pytest.raises(ValueError, match="`b` must end otherwise"):
        boundary.edge_state(equation, start, start)


def test_a_summary_of_an_edge_has_its_numbers():
    ts, omega = np.array([0.0, 10.0]), np.ones((2, 3))
    edge = boundary.Edge(ts, omega, np.array([[1.0, 2.0], [0.5, 2.5]]), np.full(2, 1e-9), True)
    assert repr(edge) == (
        "Edge(ts=[0, 10], omega=<2 × 3: 1>, shape=[1, 2, 0.5, 2.5], width=[1e-09, 1e-09], "
        "settled=True)"
    )
