"""A plain function f(τ, ω, args) as an equation of motion, for `simulate`."""

from collections.abc import Callable
from typing import Any

import equinox as eqx

from .._base.types import Vector


class PlainFunction(eqx.Module):
    """dω/dτ = f(τ, ω, args): an equation without a body and without a verdict."""

    function: Callable[..., Any] = eqx.field(static=True)

    def __call__(self, t: Any, y: Vector, args: Any = None) -> Vector:
        """Return the function's value."""
        return self.function(t, y, args)

    def lift(self, omega0: Vector) -> Vector:
        """Return ω₀, since the state is ω itself."""
        return omega0

    def omega(self, y: Vector) -> Vector:
        """Return the state, which is ω itself."""
        return y

    @property
    def level(self) -> str:
        """The name of the function."""
        return getattr(self.function, "__name__", type(self.function).__name__)
