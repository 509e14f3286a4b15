"""
The smallest kick
=================

How far is a residual rotation from stopping? ``boundary.minimal_kick`` finds the nearest start
with another fate: no other fate lies inside the circle, and the arrow just reaches one.
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

import dipoletop as dt

jax.config.update("jax_enable_x64", True)

top, start = dt.TransverseSemi(-0.2), dt.cylindrical(0.2, 0.1, 0.0)
kick = dt.boundary.minimal_kick(top, start, directions=256, radii=16).kick
side = np.cross(kick, [0.0, 1.0, 0.0])
side *= np.linalg.norm(kick) / np.linalg.norm(side)  # so that both are units of the picture
plane = dt.Grid(across=np.linspace(-2, 2, 160), along=np.linspace(-2, 2, 160))
basin = dt.sweep(lambda across, along: (top, start + along * kick + across * side), plane)
ax = dt.plots.basin(basin, shade=None, unfold=False, x="along", y="across")
ax.set_aspect("equal")
ax.add_patch(plt.Circle((0, 0), 1, fill=False, edgecolor="white"))
ax.annotate("", (1, 0), (0, 0), arrowprops={"arrowstyle": "->", "color": "white"})
