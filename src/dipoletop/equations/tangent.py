"""An equation together with its first variations, as an equation of its own."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._types import Real, State, Vector, Verdict


class Tangent(eqx.Module):
    """y′ = F(p, y) with m first variations of it, yₖ′ = (∂F/∂y) yₖ + (∂F/∂p) pₖ.

    The state is (y, y₁, …, y_m), n(1 + m) numbers. Runs of it end as those of F do, once the
    derivatives of ω∞ are certain, too; `slopes` gives these. It is an equation as any other:
    simulate, classify or sweep it.

    Args:
        equation: the equation F, with a `verdict` if runs are to end.
        parameters: pₖ, the arrays of the equation (others None) with an axis of m in front.
        starts: the variations of ω₀, shape (m, 3).
    """

    equation: Any
    parameters: Any
    starts: Float[Array, "m 3 *lanes"]

    @property
    def _parts(self) -> tuple[Any, Any]:
        """The arrays that vary, and the rest of the equation."""
        return eqx.partition(self.equation, eqx.is_inexact_array)

    def _push(self, function: Any, point: Any, variations: list[Any]) -> tuple[Any, list[Any]]:
        """A function of the equation and another point: its value and its variations."""
        arrays, rest = self._parts

        def varied(arrays: Any, point: Any) -> Any:
            return function(eqx.combine(arrays, rest), point)

        value, linear = jax.linearize(varied, arrays, point)
        along = [jax.tree.map(lambda p, k=k: p[k], self.parameters) for k in range(self.m)]
        return value, [linear(*pair) for pair in zip(along, variations, strict=True)]

    @property
    def m(self) -> int:
        """The number of variations."""
        return self.starts.shape[0]

    def _split(self, y: Array) -> list[Array]:
        n = y.shape[0] // (1 + self.m)
        return [y[n * k : n * (k + 1)] for k in range(1 + self.m)]

    def __call__(self, t: Any, y: State, args: Any = None) -> State:
        """The rates of the state and of its variations."""
        state, *variations = self._split(y)
        rate, rates = self._push(lambda equation, y: equation(t, y, args), state, variations)
        return jnp.concatenate([rate, *rates])

    def lift(self, omega0: Vector) -> State:
        """The state that starts at `omega0`, with variations `starts`."""
        state, variations = self._push(
            lambda equation, omega: equation.lift(omega), omega0, list(self.starts)
        )
        return jnp.concatenate([state, *variations])

    def omega(self, y: State) -> Vector:
        """The angular velocity of a state."""
        return self.equation.omega(self._split(y)[0])

    def verdict(self, y: State) -> Verdict:
        """That of the equation."""
        return Verdict(*self.equation.verdict(self._split(y)[0]))

    def slopes(self, y: State) -> Float[Array, "m *lanes"]:
        """The variations of ω∞, where the verdict on a state says that they are certain."""
        state, *variations = self._split(y)
        return jnp.stack(
            self._push(
                lambda equation, y: Verdict(*equation.verdict(y)).omega_inf, state, variations
            )[1]
        )

    @property
    def runaway_rate(self) -> Real:
        """That of a full equation; others have none."""
        return self.equation.runaway_rate

    @property
    def body(self) -> Any:
        """The body that the equation moves."""
        return self.equation.body

    @property
    def level(self) -> str:
        """Which level of the equation of motion this is."""
        return getattr(self.equation, "level", type(self.equation).__name__)
