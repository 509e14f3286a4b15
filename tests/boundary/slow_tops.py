"""Starts of small amplitude, where the basin boundary is that of the planar system."""

import numpy as np

import dipoletop as dt
from dipoletop import boundary

DELTA = -0.2
Z_S = 4.2553355749  # physics: z_s(0) of order 1
SLOPE = 32.685861  # dz_s/dδ there, the derivative of the manifold of the planar system
RESIDUAL, ROTATING = dt.Fate.POSITIVE, dt.Fate.ROTATING


def slow(delta, z, phi, w):
    """A start of small amplitude, where the boundary is that of the planar system."""
    return dt.TransverseReduced(delta), dt.cylindrical(w, z * w**2, phi)


def across(z=(4.0, 4.5), **changes):
    """Segments across the boundary at φ = 0."""
    point = {"delta": DELTA, "phi": 0.0, "w": 1e-3, **changes}
    return boundary.bisect(slow, {"z": z[0], **point}, {"z": z[1], **point})


def backwards(sigma, y):
    """The planar system of order 1, with σ reversed."""
    phi, z = y
    growth = z * (1 - (2 + DELTA) / (1 - DELTA) * np.cos(phi) ** 2)
    return [DELTA * z + np.sin(2 * phi) / 2, -growth]
