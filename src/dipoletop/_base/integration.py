"""Integration by diffrax, of order 8 and differentiable in forward mode."""

from collections.abc import Callable
from typing import Any

import diffrax
from jaxtyping import Array


def integrated(
    field: Callable[..., Array],
    span: tuple[Any, Any],
    y0: Array,
    controller: diffrax.AbstractStepSizeController,
    max_steps: int,
    first_step: Any = None,
    **options: Any,
) -> Any:
    """Return diffrax's solution of dy/dt = field(t, y, args); if it fails, that raises no error.

    Args:
        field: the rates.
        span: first and last t.
        y0: the state at the first t.
        controller: the controller of the step sizes.
        max_steps: largest number of steps.
        first_step: the first step; None: the controller chooses it.
        options: `saveat` and `event` of diffrax.
    """
    return diffrax.diffeqsolve(
        diffrax.ODETerm(field),
        diffrax.Dopri8(),
        *span,
        first_step,
        y0,
        stepsize_controller=controller,
        max_steps=max_steps,
        adjoint=diffrax.ForwardMode(),
        throw=False,
        **options,
    )
