"""ω∞ by an independent integrator: heyoka's Taylor method in long double.

At a capture ω⊥ and ω₃ ~ ω⊥² may be smaller than at the start by many orders of magnitude, and
heyoka's tolerance is absolute below 1. So the variables are x = ω₁/A, y = ω₂/A and z = ω₃/B; the
units A, B, and 1/r of time, follow the motion. A run ends so near the residual line that the
quadratic form ω∞ = ω₁(1 + Q₂) is exact to rounding.
"""

from typing import Any

import heyoka
import numpy as np

Long = np.longdouble
TOLERANCE = 2e-19
NEAR = 1e-5  # largest ω₂/ω₁ and ω₃/ω₁² at the end: the next term is of the fourth power
SMALL = 0.05  # x² + y² or |z| below which new units are chosen
BATCH = 64  # largest number of steps with the same units


def _order_1(d: Any, spin: Any, a2: Any, b2: Any, _: Any) -> Any:
    """Return (4.2)–(4.4), times r; the parameters are δB/r, A²/r, B²/r."""
    x, y, z = heyoka.make_vars("x", "y", "z")
    drag = a2 * (x * x + y * y) + (1 + d + d * d) * b2 * z * z
    axial = a2 * ((1 + 2 * d) / (1 - d) * x * x + y * y) + b2 / (1 - d) * z * z
    return [(x, spin * y * z), (y, -spin * x * z - drag * y), (z, -axial * z)]


def _semi(d: Any, spin: Any, a2: Any, b2: Any, units: Any) -> Any:
    """Return the semi-reduced level, times r; the other parameters are B, A² and A²/B."""
    b, square, ratio = units
    x, y, z = heyoka.make_vars("x", "y", "z")
    u = x * x + y * y
    r2 = -spin * x * z - (a2 * u + b2 * (1 + d + d * d) * z * z) * y
    r3 = -(a2 * (u - d * y * y) + b2 * z * z) * z
    inverse = 1 / (1 - d + 4 * square * x * x)
    second = ((1 - d) * r2 - 2 * b * x * r3) * inverse
    return [(x, spin * y * z), (y, second), (z, (r3 + 2 * ratio * x * r2) * inverse)]


FIELDS = {"order-1": _order_1, "semi": _semi}


class Truth:
    """An integrator for the residual rotation at one level.

    Args:
        level: "order-1" or "semi".
    """

    def __init__(self, level: str) -> None:
        self.level = level
        par = heyoka.par
        system = FIELDS[level](par[0], par[1], par[2], par[3], (par[4], par[5], par[6]))
        self.integrator = heyoka.taylor_adaptive(
            system,
            np.ones(3, Long),
            pars=np.zeros(7 if level == "semi" else 4, Long),
            fp_type=Long,
            tol=Long(TOLERANCE),
        )

    def residual(self, delta: Any, omega0: Any, max_steps: int = 100_000) -> np.longdouble:
        """Return ω∞ of a top that ends in residual rotation; NaN if the budget runs out before."""
        d, w = Long(delta), np.asarray(omega0, Long)
        for _ in range(0, max_steps, BATCH):
            t, z = w[1] / w[0], w[2] / w[0] ** 2
            if max(abs(t), abs(z)) < NEAR:
                return w[0] * (1 + self._form(d, t, z, w[0] ** 2))
            w = self._some_steps(d, w)
        return Long(np.nan)

    def _some_steps(self, d: Any, w: np.ndarray) -> np.ndarray:
        a = np.hypot(w[0], w[1])
        b = max(abs(w[2]), SMALL**2 * a**2)
        r = max(abs(d) * b, a**2, b**2)
        pars = np.array([d, d * b / r, a**2 / r, b**2 / r, b, a**2, a**2 / b])
        run = self.integrator
        run.pars[:] = pars[: len(run.pars)]
        run.state[:] = w / np.array([a, a, b])
        run.time = Long(0)
        for _ in range(BATCH):
            run.step()
            x, y, z = run.state
            if x * x + y * y < SMALL or abs(z) < SMALL or abs(y) < NEAR * abs(x):
                break
        return run.state * np.array([a, a, b])

    def _form(self, d: Any, t: Any, z: Any, v: Any) -> Any:
        """Return Q₂, derived by hand for these two levels."""
        if self.level == "order-1":
            beta = (1 + 2 * d) / (1 - d)
            return d * t * z / (1 + beta) - d**2 * z**2 / (2 * beta * (1 + beta))
        along = (1 - d) * (1 + 2 * d) * t * z + (1 - d) * (2 * v - d * (1 - d)) * z**2 / 2
        return d / (2 + d) * (along - (1 + 2 * d) * t**2)
