"""Step sizes: the error of a step, the error that is allowed, and the first step.

Errors are relative to the present |ω|, not to |ω₀|: a top may be captured into residual rotation
after |ω| has fallen by many orders of magnitude, and ω∞ is decided there.
"""

import functools
import math
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._base.linalg import largest
from .._base.tolerances import Tolerances
from .._base.types import ErrorScale, Real, State
from ..equations._common import jumps_of

FIRST = 2.5  # first step over time scale · tolerance^(1/order); steps up to 2.5 … 6 are accepted


def error_ratio(
    sizes: ErrorScale, error: State, ends: Any, tolerances: Tolerances
) -> Float[Array, "*lanes"]:
    """Return the largest ratio of error to allowed error of a step between the states `ends`."""
    rtol, atol = tolerances
    allowed = atol[None] + rtol * jnp.maximum(*map(sizes, ends))
    return largest(jnp.abs(error) / jnp.maximum(allowed, jnp.finfo(allowed.dtype).tiny))


def first_step(
    equation: Any, sizes: ErrorScale, y: State, f: State, tolerances: Tolerances, order: int
) -> Real:
    """Return the first step size, with which the error of the step is about the tolerance.

    With y, ẏ and ÿ in units of the tolerance it is FIRST·min(|y|/|ẏ|, √(|y|/|ÿ|))·|y|^(−1/order).
    It is proportional to the time scale, whatever the unit of time. As in Hairer, Nørsett, Wanner,
    *Solving Ordinary Differential Equations I*, section II.4, ÿ comes from a short Euler step.
    """
    ratio = functools.partial(
        error_ratio, sizes, ends=(y, jnp.zeros_like(y)), tolerances=tolerances
    )
    d0, d1 = ratio(y), ratio(f)
    moves = (d0 > 0) & (d1 > 0)
    h0 = jnp.where(moves, 0.01 * d0 / jnp.where(moves, d1, 1.0), 1e-6)
    f1 = equation(h0, y + h0[None] * f, None)
    d2 = jnp.maximum(ratio(f1 - f) / h0, jnp.finfo(h0.dtype).tiny)
    time = jnp.minimum(100 * h0, jnp.sqrt(d0 / d2))
    time = jnp.minimum(time, float(jnp.finfo(h0.dtype).max) ** 0.5)  # |ω|² may underflow
    return jnp.where(moves, FIRST * time / root(jnp.where(moves, d0, 1.0), order), h0)


def root(x: Real, order: int) -> Real:
    """Return x^(1/order) by square roots, which are fast; the order is rounded to a power of 2."""
    for _ in range(max(1, round(math.log2(order)))):
        x = jnp.sqrt(x)
    return x


def ending_at_jumps(
    controller: diffrax.AbstractStepSizeController, equation: Any
) -> diffrax.AbstractStepSizeController:
    """Return a controller whose steps end where a torque jumps; one of constant steps as it is."""
    jumps, kind = jumps_of(equation), diffrax.AbstractAdaptiveStepSizeController
    if jumps is None or not isinstance(controller, kind):
        return controller
    return diffrax.ClipStepSizeController(controller, jump_ts=jumps)


class Controller(diffrax.AbstractAdaptiveStepSizeController):
    """diffrax's `PIDController` with errors measured by `sizes` and the first step of `first_step`.

    Attributes:
        rtol: relative tolerance.
        atol: absolute tolerance.
        sizes: the scale of the relative error of each component.
        pid: the controller that chooses the next step.
    """

    rtol: Real
    atol: Real
    sizes: ErrorScale
    pid: diffrax.PIDController

    def __init__(self, rtol: Real, atol: Real, sizes: ErrorScale) -> None:
        self.rtol, self.atol, self.sizes = rtol, atol, sizes
        least = jnp.finfo(jnp.result_type(float)).tiny  # diffrax divides by the allowed error
        self.pid = diffrax.PIDController(rtol, jnp.maximum(atol, least), norm=self.norm)

    @staticmethod
    def norm(x: State) -> Float[Array, ""]:
        """Return the largest absolute component."""
        return jnp.max(jnp.abs(x))

    def wrap(self, direction: Any) -> "Controller":
        """Return the controller for a direction of time (diffrax's interface)."""
        return eqx.tree_at(lambda c: c.pid, self, self.pid.wrap(direction))

    def init(self, terms, t0, t1, y0, dt0, args, func, error_order: Any):
        """Return the first step and the initial state of the controller (diffrax's interface)."""
        if dt0 is None:

            def field(h: Any, y: State, _: Any) -> State:
                return func(terms, t0 + h, y, args)

            f0 = field(0.0, y0, None)
            order = int(error_order)
            dt0 = first_step(field, self.sizes, y0, f0, Tolerances(self.rtol, self.atol), order)
            dt0 = jax.lax.stop_gradient(dt0)
        return self.pid.init(terms, t0, t1, y0, dt0, args, func, error_order)

    def adapt_step_size(
        self, t0, t1, y0, y1_candidate, args, y_error, error_order, controller_state
    ):
        """Judge a step by its error over the sizes of y₀ and y₁ (diffrax's interface)."""
        ends = self.sizes(y0), self.sizes(y1_candidate)
        return self.pid.adapt_step_size(t0, t1, *ends, args, y_error, error_order, controller_state)
