"""
Counts without keeping every start
==================================

A tally counts outcomes and fills histograms while it computes, so that it may have more starts
than a disk holds. Here: the times at which outcomes are certain, by shape.
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

import dipoletop as dt

jax.config.update("jax_enable_x64", True)


def problem(delta, w3, phi):
    return dt.TransverseSemi(delta), dt.cylindrical(0.2, w3, phi)


deltas, edges = np.linspace(-0.9, 0.9, 37), np.geomspace(1, 1e5, 41)
grid = dt.Grid(delta=deltas, w3=np.linspace(0, 0.6, 60), phi=np.linspace(0, np.pi, 60))
found = dt.tally(problem, grid, keep="delta", histograms={"time": edges})
plt.pcolormesh(deltas, edges[:-1], found.histogram("time").T, cmap="cividis")
plt.gca().set(yscale="log", xlabel=r"$\delta$", ylabel=r"$\tau$ at which it is certain")
plt.colorbar(label="starts")
