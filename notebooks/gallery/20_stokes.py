"""
Its polarisation
================

The Stokes parameters towards observers at every angle from the angular momentum: circular along
it, linear across it.
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

import dipoletop as dt

jax.config.update("jax_enable_x64", True)

body, spin = dt.axisymmetric(-0.5), [0.0, 0.0, 1.0]
angles = np.linspace(0, np.pi, 41)
seen = [dt.stokes(body, spin, [np.sin(a), 0.0, np.cos(a)], n=1).total for a in angles]
_, ax = plt.subplots(figsize=(6, 4), layout="constrained")
for name, values in zip("IQUV", np.transpose(seen), strict=True):
    ax.plot(np.degrees(angles), values, label=name)
ax.set(xlabel="angle from L in degrees", ylabel="power per unit solid angle")
ax.legend(frameon=False)
