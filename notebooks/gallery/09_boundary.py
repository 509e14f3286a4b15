"""
The boundary as a curve
=======================

``boundary.bisect`` finds one point of the boundary to rounding; ``boundary.trace`` follows the
curve from there, with its normals, round folds.
"""

import jax
import numpy as np

import dipoletop as dt

jax.config.update("jax_enable_x64", True)


def problem(w3, phi):
    return dt.TransverseSemi(-0.2), dt.cylindrical(0.2, w3, phi)


ax = dt.plots.basin(dt.sweep(problem, dt.symmetry_cell(n_phi=128, n_w3=128, w3_max=0.6)))
crossing = dt.boundary.bisect(problem, {"w3": 0.0, "phi": np.pi}, {"w3": 0.6, "phi": np.pi})
box = {"phi": (0, 2 * np.pi), "w3": (-0.6, 0.6)}
curve = dt.boundary.trace(crossing, box, step=0.04)
ax.plot(*curve.points.T, color="#f0e442", linewidth=2)
