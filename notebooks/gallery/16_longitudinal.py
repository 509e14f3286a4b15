"""
A closed form
=============

The dipole along the symmetry axis: order 1 has the exact solution (3.11). Dots are integrated.
The full equation, dashed, decays more slowly.
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

import dipoletop as dt

jax.config.update("jax_enable_x64", True)

start, times = [0.4, 0.0, 0.3], np.linspace(0, 60, 121)
exact = dt.exact.longitudinal(-0.4, start, times)
run = dt.simulate(dt.LongitudinalReduced(-0.4), start, times)
full = dt.simulate(dt.LongitudinalFull(-0.4), start, times)
_, ax = plt.subplots(figsize=(6, 4), layout="constrained")
ax.semilogy(times, np.hypot(*exact[:, :2].T), label="(3.11)")
ax.semilogy(times[::6], np.hypot(*run.omega[::6, :2].T), "o", label="order 1, integrated")
ax.semilogy(times, np.hypot(*full.omega[:, :2].T), "--", label="full equation")
ax.set(xlabel=r"$\tau$", ylabel=r"$\omega_\perp$")
ax.legend(frameon=False)
