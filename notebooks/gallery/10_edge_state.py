"""
The motion on the boundary
==========================

A motion on the boundary comes to rest, too, but in a way of its own: φ and ω₃/ω⊥² tend to fixed
values. This edge state (circle) is a saddle, which for small amplitudes is known.
"""

import jax
import matplotlib.pyplot as plt

import dipoletop as dt

jax.config.update("jax_enable_x64", True)

_, ax = plt.subplots(figsize=(6.5, 4.4), layout="constrained")
for phi in (0.0, 1.4):
    inside, outside = (dt.cylindrical(0.2, w3, phi) for w3 in (0.0, 0.6))
    edge = dt.boundary.edge_state(dt.TransverseSemi(-0.2), inside, outside, shape_tol=1e-4)
    ax.plot(*edge.shape.T, ".-", label=rf"from $\varphi = {phi}$")
saddle = dt.planar.saddle(dt.planar.Planar(-0.2))
ax.plot(saddle.phi, saddle.z, "ko", fillstyle="none", markersize=10, label="saddle of the plane")
ax.set(xlabel=r"$\varphi$", ylabel=r"$z = \omega_3/\omega_\perp^2$")
ax.legend(frameon=False)
