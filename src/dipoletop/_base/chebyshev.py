"""Chebyshev collocation in integral form."""

import functools

import numpy as np


@functools.cache
def rule(nodes: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Chebyshev nodes on [0, 1], the integrals from 0 to each, values to coefficients."""
    x = -np.cos(np.pi * np.arange(nodes) / (nodes - 1))
    polynomial = np.polynomial.chebyshev
    coefficients = np.linalg.inv(polynomial.chebvander(x, nodes - 1))
    sums = [polynomial.chebval(x, polynomial.chebint(row, lbnd=-1)) for row in np.eye(nodes)]
    return (x + 1) / 2, np.stack(sums, axis=1) @ coefficients / 2, coefficients
