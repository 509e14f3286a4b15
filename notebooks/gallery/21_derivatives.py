"""
A map of derivatives
====================

How the residual rotation changes with the shape of the body: a sweep integrates the first
variations with the motions. The derivative grows without bound at the boundary.
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

import dipoletop as dt

jax.config.update("jax_enable_x64", True)


def problem(delta, w3, phi):
    return dt.TransverseSemi(delta), dt.cylindrical(0.2, w3, phi)


grid = dt.Grid(delta=-0.2, w3=np.linspace(0, 0.6, 160), phi=np.linspace(0, np.pi, 160))
basin = dt.sweep(problem, grid, derivatives=["delta"])
slope = np.where(basin.outcome == dt.Outcome.RESIDUAL, basin.derivative("delta"), np.nan)[0]
plt.gca().set_facecolor("0.3")  # where the body stops there is no derivative
picture = plt.pcolormesh(grid.coords["phi"], grid.coords["w3"], slope, cmap="RdBu", vmin=-2, vmax=2)
plt.colorbar(picture, label=r"$\partial\omega_\infty/\partial\delta$", extend="both")
plt.gca().set(xlabel=r"$\varphi$", ylabel=r"$\omega_3$", title="Grey: the body stops")
