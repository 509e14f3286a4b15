"""
The future of a real grain
==========================

A grain of 100 × 60 × 40 nm with a dipole of 2400 D turns at 1 GHz. ``predict`` follows the
averages of its energy and its angular momentum to the end, over more turns than anybody can
integrate.
"""

import jax

import dipoletop as dt

jax.config.update("jax_enable_x64", True)

dipole = [0.0, 0.0, 2400 * dt.particles.DEBYE]
grain = dt.Particle.cuboid([1e-7, 6e-8, 4e-8], dipole, density=2000)  # m, C m, kg/m³
start = dt.particles.start(grain, "1 GHz", momentum=[1, 1, 1])
figure = dt.plots.history(dt.predict(grain, start))
