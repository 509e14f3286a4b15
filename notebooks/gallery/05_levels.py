"""
Two levels of the equation
==========================

The article's equation, order 1, and the semi-reduced one, which keeps a term of leading order
that order 1 drops. Hatched: the outcome differs.
"""

import jax

import dipoletop as dt

jax.config.update("jax_enable_x64", True)


def basin(equation):
    cell = dt.symmetry_cell(n_phi=192, n_w3=192, w3_max=0.6)
    return dt.sweep(lambda w3, phi: (equation, dt.cylindrical(0.2, w3, phi)), cell)


figure = dt.plots.compare(basin(dt.TransverseReduced(-0.2)), basin(dt.TransverseSemi(-0.2)))
