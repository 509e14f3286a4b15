"""The collocation rule against integrals of powers."""

import numpy as np

from dipoletop._base.chebyshev import collocation_rule


def test_polynomials_are_integrated_exactly():
    x, integrals, coefficients = collocation_rule(8)
    assert (x[0], x[-1]) == (0.0, 1.0)
    for power in range(8):
        np.testing.assert_allclose(integrals @ x**power, x ** (power + 1) / (power + 1), atol=1e-15)
        series = np.polynomial.Chebyshev(coefficients @ x**power, domain=[0, 1])
        np.testing.assert_allclose(series(0.3), 0.3**power, atol=1e-15)
