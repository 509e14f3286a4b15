"""The edge state against the saddle of the planar system."""

import numpy as np
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
