"""The limits of runs that engines are given directly."""

import jax.numpy as jnp
import numpy as np

from dipoletop._engines.interface import Limits


def limits(starts, rtol=1e-9, t1=jnp.inf, max_steps=100_000):
    """Tolerances in proportion to |ω₀|; the end time is one number, or one for each start."""
    size = np.linalg.norm(starts, axis=0)
    given = rtol, rtol * size, np.broadcast_to(t1, size.shape), max_steps
    return Limits(*map(jnp.asarray, given))
