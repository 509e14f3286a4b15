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
series = np.random.default_rng(0).normal(dt.simulate(*problem(-0.2, 0.2, 0.3), ts).omega, 0.01)
best = dt.fitting.fit(problem, ts, series, {"delta": -0.1, "w3": 0.25, "phi": 0.1}, sigma=0.01)
plt.gca().set_prop_cycle(color=["tab:blue", "tab:orange", "tab:green"])
plt.plot(ts, series, ".", ts, dt.simulate(*problem(**best.parameters), ts).omega)
fitted = rf"$\delta = {best.parameters['delta']:.3f} \pm {best.errors['delta']:.3f}$, true $-0.2$"
plt.legend([rf"$\omega_{k}$" for k in (1, 2, 3)], frameon=False)
plt.gca().set(xlabel=r"$\tau = t/\tau_0$", ylabel=r"$\omega = \tau_0\Omega$", title=fitted)
