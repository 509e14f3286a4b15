"""
The plane rotator
=================

The phase plane of the full equation ω″ = ω′ + ω³. Only the motions on one curve are physical, AOC
in figure 3 of the article; all others run away, forwards in time.
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

import dipoletop as dt

jax.config.update("jax_enable_x64", True)

w, rate = np.linspace(-2, 2, 41), np.linspace(-2, 2, 41)
_, ax = plt.subplots(figsize=(6, 5), layout="constrained")
ax.streamplot(w, rate, *np.broadcast_arrays(rate[:, None], rate[:, None] + w**3), color="0.8")
ax.plot(w, dt.critical_manifold(w), label="AOC, the physical motions")
ax.plot(w, dt.separatrix(w), label="BOD, those that come from rest")
ax.plot(w, dt.closed_manifold(w), ":", label="closed approximation of AOC")
ax.set(xlabel=r"$\omega$", ylabel=r"$\omega'$", ylim=(-2, 2))
ax.legend(loc="upper left")
