"""
Where the energy goes
=====================

The full equation balances exactly: kinetic energy, what has been radiated, and the Schott energy
in the near field. A reduced level leaves a defect, which is its own error.
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

import dipoletop as dt

jax.config.update("jax_enable_x64", True)

times = np.geomspace(0.1, 3e3, 200)
start = dt.cylindrical(w_perp=0.2, w3=0.2, phi=np.pi / 30)
run = dt.simulate(dt.TransverseSemi(-0.2), start, times, balance=True)
_, ax = plt.subplots(figsize=(7, 4), layout="constrained")
ax.plot(times, run.energy / run.energy[0], label="kinetic energy")
ax.plot(times, run.emitted / run.energy[0], "--", label="radiated")
ax.plot(times, 1 + run.balance_defect, ":", label="both, and the Schott energy")
ax.set(xscale="log", xlabel=r"$\tau$", ylabel="over the initial energy")
ax.legend(frameon=False)
