"""
How long it takes
=================

The same plane, shaded by the time at which the outcome is decided. Near the boundary it takes
longest, since the motion follows the boundary first.
"""

import jax

import dipoletop as dt

jax.config.update("jax_enable_x64", True)


def problem(w3, phi):
    return dt.TransverseSemi(-0.2), dt.cylindrical(0.2, w3, phi)


basin = dt.sweep(problem, dt.symmetry_cell(n_phi=192, n_w3=192, w3_max=0.6))
dt.plots.basin(basin, shade="time")
