"""
A fit to a noisy series
=======================

Forty noisy values of ω give the shape of the body and its start, with their errors.
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

import dipoletop as dt

jax.config.update("jax_enable_x64", True)


def problem(delta, w3, phi):
    return dt.TransverseSemi(delta), dt.cylindrical(0.2, w3, phi)


ts = np.linspace(0, 80, 40)
series = dt.simulate(*problem(-0.2, 0.2, 0.3), ts).omega
series = series + 0.01 * np.random.default_rng(0).normal(size=series.shape)
best = dt.fitting.fit(problem, ts, series, {"delta": -0.1, "w3": 0.25, "phi": 0.1}, sigma=0.01)
plt.plot(ts, series, ".", ts, dt.simulate(*problem(**best.parameters), ts).omega)
found, error = best.parameters["delta"], best.errors["delta"]
plt.title(rf"$\delta = {found:.3f} \pm {error:.3f}$, true $-0.2$", fontsize="medium")
plt.xlabel(r"$\tau$")
