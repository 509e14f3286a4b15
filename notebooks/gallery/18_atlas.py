"""
An atlas of all bodies
======================

Every ratio of the moments of inertia is a point of the triangle. The dipole lies on the axis of
the smallest moment: residual rotation by its mean L∞/L₀, stops by their kind.
"""

import jax

import dipoletop as dt

jax.config.update("jax_enable_x64", True)

figure = dt.plots.atlas(dt.atlas(1, n=14))
