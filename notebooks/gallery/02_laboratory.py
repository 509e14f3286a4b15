"""
The dipole in the laboratory
============================

The attitude is integrated with the motion. The tip of the dipole wanders over the sphere, and
comes to rest where the axis of the residual rotation is.
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

import dipoletop as dt

jax.config.update("jax_enable_x64", True)

start = dt.cylindrical(w_perp=0.2, w3=0.2, phi=np.pi / 30)
times = np.linspace(0, 600, 4001)
run = dt.simulate(dt.TransverseSemi(-0.2), start, times, attitude=[1.0, 0.0, 0.0, 0.0])
ax = plt.figure(figsize=(5.5, 5.0), layout="constrained").add_subplot(projection="3d")
points = ax.scatter(*run.dipole.T, c=1 + times, s=1, cmap="cividis", norm="log")
plt.colorbar(points, label=r"$1 + \tau$", shrink=0.6, pad=0.12)
ax.set(xlabel="$x$", ylabel="$y$", zlabel="$z$", title="Tip of the dipole")
ax.set_box_aspect((1, 1, 1))
