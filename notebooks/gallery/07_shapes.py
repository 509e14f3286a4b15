"""
Outcomes against the shape
==========================

The angle of the start and the shape δ of the body span the plane. Oblate bodies have both
outcomes; for prolate ones nearly every start keeps rotating, until needles find a second way to
stop.
"""

import jax
import numpy as np

import dipoletop as dt

jax.config.update("jax_enable_x64", True)


def problem(delta, phi):
    return dt.TransverseSemi(delta), dt.cylindrical(0.2, 0.2, phi)


grid = dt.Grid(delta=np.linspace(-0.95, 0.95, 192), phi=np.linspace(0, np.pi, 192))
dt.plots.basin(dt.sweep(problem, grid), x="phi", y="delta", unfold=False)
