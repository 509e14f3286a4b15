"""
The same map from few runs
==========================

Labels change at the boundary only. ``adaptive.refine`` integrates next to it (dots), and fills
in the rest.
"""

import jax
import numpy as np

import dipoletop as dt

jax.config.update("jax_enable_x64", True)


def problem(w3, phi):
    return dt.TransverseSemi(-0.2), dt.cylindrical(0.2, w3, phi)


grid = dt.Grid(w3=np.linspace(0, 0.6, 256), phi=np.linspace(0, np.pi, 256))
basin = dt.adaptive.refine(problem, grid, coarse=32)
ax = dt.plots.basin(basin, unfold=False)
rows, columns = np.nonzero(basin.column("computed"))
ax.plot(grid.coords["phi"][columns], grid.coords["w3"][rows], ".", color="#f0e442", markersize=1.5)
