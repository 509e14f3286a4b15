"""
Outcomes and stability against the shape
========================================

Above, the share of isotropic starts that keep rotating, at two levels. Below, the growth rate of
perturbations of that rotation. The threshold δ = −1/2 belongs to order 1.
"""

import jax
import numpy as np

import dipoletop as dt

jax.config.update("jax_enable_x64", True)

shapes = np.linspace(-0.95, 0.95, 39)
found = dt.continuation.continuation(shapes, 0.2, levels=["order-1", "semi"], n=600)
figure = dt.plots.diagram(found)
