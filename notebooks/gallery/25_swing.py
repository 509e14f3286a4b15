"""
A dipole that swings in a field
===============================

A field pulls the dipole of a sphere back, and its radiation damps the swing. Small angles fall as
exp(−ν²τ/2), with the frequency ν of the swing (dashed); large swings radiate more.
"""

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt

import dipoletop as dt

jax.config.update("jax_enable_x64", True)

top, ts, attitude = dt.TransverseSemi(0.0), jnp.linspace(0.0, 300.0, 1501), [1.0, 0.0, 0.0, 0.0]
_, ax = plt.subplots(figsize=(7, 3.6), layout="constrained")
for start in (0.1, 1.5):  # from the field to the dipole
    pull = dt.torques.field_on_dipole(top, [0.03 * jnp.cos(start), -0.03 * jnp.sin(start), 0.0])
    swinging = dt.torques.with_torque(top, pull, attitude=attitude)
    run = dt.simulate(swinging, [0.0, 0.0, 0.0], ts)
    ax.plot(ts, 1 + jnp.arctan2(*run.dipole.T[1::-1]) / start, label=f"released at {start} rad")
ax.plot(ts, jnp.exp(-0.03 * ts / 2), "k--", linewidth=0.8)
ax.set(xlabel=r"$\tau$", ylabel="angle / first angle")
ax.legend(frameon=False)
