"""
The light of a tumbling grain
=============================

The dipole radiation of free rotation has lines at the frequencies j·2π/T, from the dipole along L,
and at Φ̇ + j·2π/T, from the dipole across L. T is the period of Ω in body axes, Φ̇ the mean
precession about L.
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

import dipoletop as dt

jax.config.update("jax_enable_x64", True)

body = dt.Body(np.diag([1.0, 1.6, 2.1]), [0.6, 0.3, 0.7])
found = dt.lines(body, [1.0, 0.3, 0.9], n=8)
_, ax = plt.subplots(figsize=(6.5, 4), layout="constrained")
ax.stem(found.frequency, found.power / found.total, basefmt=" ")
ax.set(yscale="log", ylim=(1e-8, 2), xlim=(0, 8))
ax.set(xlabel=r"angular frequency $\omega\tau_0$", ylabel="share of the power")
ax.set_title(f"share of the power in further lines: {found.missing:.0e}", fontsize="medium")
