"""
Which parameter matters
=======================

Sobol indices split the variance of the outcome between the parameters of a box: alone, and with
all their interactions.
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

import dipoletop as dt

jax.config.update("jax_enable_x64", True)


def problem(delta, w3, phi):
    return dt.TransverseSemi(delta), dt.cylindrical(0.2, w3, phi)


bounds = {"delta": (-0.3, -0.1), "w3": (0.1, 0.3), "phi": (0.0, np.pi)}
found = dt.uncertainty.sobol(problem, bounds, n=1024, target="residual")
for shift, part, label in ((-0.2, found.first, "alone"), (0.2, found.total, "with others, too")):
    heights = [index.value for index in part.values()]
    plt.bar(np.arange(3) + shift, heights, 0.4, label=label)
plt.xticks(range(3), [r"$\delta$", r"$\omega_3$", r"$\varphi$"])
plt.ylabel("share of the variance")
plt.legend(frameon=False)
