"""Directions that are spread evenly over a sphere."""

import math

import numpy as np
from jaxtyping import Float


def spread_directions(n: int) -> Float[np.ndarray, "n 3"]:
    """Return the n points of a Fibonacci spiral on the unit sphere; each represents an area 4π/n.

    The mean of a smooth function over them differs from its mean over the sphere by O(1/n), not
    O(1/√n).
    """
    k = np.arange(n) + 0.5
    cosine = 1 - 2 * k / n
    sine = np.sqrt(1 - cosine**2)
    angle = (math.sqrt(5) - 1) * math.pi * k
    return np.stack([sine * np.cos(angle), sine * np.sin(angle), cosine], axis=1)
