"""
Spectra of the residual rotation
================================

Eigenvalues of perturbations of the rotation about the dipole, over w², against the shape. At the
semi-reduced level the real parts are negative for every shape, at order 1 only above δ = −1/2.
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

import dipoletop as dt

jax.config.update("jax_enable_x64", True)

shapes = np.linspace(-0.95, 0.9, 75)
found = dt.continuation.follow_spectrum(shapes, w=0.05, levels=["order-1", "semi"])
_, axes = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
for level, slow, colour in zip(found.levels, found.slow, ("C1", "C0"), strict=True):
    first, *_ = axes[0].plot(shapes, slow.real.T / 0.05**2, color=colour)
    first.set_label(level.label)  # the other eigenvalues of the level have its colour
    axes[1].plot(shapes, slow.imag.T / 0.05**2, color=colour)
axes[0].set(xlabel=r"$\delta$", ylabel=r"Re $\lambda/w^2$", ylim=(-4, 4))
axes[1].set(xlabel=r"$\delta$", ylabel=r"Im $\lambda/w^2$")
axes[0].legend(frameon=False, fontsize="small")
