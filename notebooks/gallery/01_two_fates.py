"""
Two fates
=========

Two starts differ by an angle only. The first top ends in rotation about its dipole, which does
not radiate. The second stops, ever more slowly.
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

import dipoletop as dt

jax.config.update("jax_enable_x64", True)

times = np.concatenate([[0.0], np.geomspace(1, 1e4, 200)])
_, axes = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained", sharey=True)
for ax, phi in zip(axes, (np.pi / 30, np.pi / 3), strict=True):
    start = dt.cylindrical(w_perp=0.2, w3=0.2, phi=phi)
    dt.plots.trajectory(dt.simulate(dt.TransverseSemi(-0.2), start, times), ax=ax)
