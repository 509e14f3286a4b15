"""
Smooth or fractal?
==================

The share of starts whose fate changes when an angle moves by ±ε falls as a power of ε. Its
exponent is 1 here: the boundary is smooth.
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

import dipoletop as dt

jax.config.update("jax_enable_x64", True)


def problem(w3, phi):
    return dt.TransverseSemi(-0.2), dt.cylindrical(0.2, w3, phi)


region = dt.Grid(w3=[0.0, 0.6], phi=[0.0, np.pi])
epsilons = np.geomspace(3e-3, 0.1, 7)
found = dt.complexity.uncertainty_exponent(problem, region, epsilons=epsilons, n=40_000)
_, ax = plt.subplots(figsize=(6, 4), layout="constrained")
ax.errorbar(found.epsilons, found.fractions, 2 * found.fraction_errors, fmt="o", capsize=3)
ax.loglog(found.epsilons, found.fractions[0] * found.epsilons / found.epsilons[0], ":")
ax.set(xlabel=r"$\epsilon$", ylabel="uncertain share", title=f"exponent {found.exponent:.3f}")
