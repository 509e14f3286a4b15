"""An equation together with its first variations, as an equation of its own."""

import functools
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .._base.guards import safe_divisor as guarded
from .._base.linalg import cross, largest, matvec
from .._base.types import Real, State, Vector, Verdict
from ..bodies import Body
from ._common import Scales, scales_of, sizes_of
from ._verdicts.dipole_frame import constraints, rounding
from ._verdicts.nonsmooth import infinite
from .levels import Level

LEAST = 1e-2  # of |ω|: variations below it, for a change by 1, need not be exact


class Tangent(eqx.Module):
    """y′ = F(p, y) with m first variations of it, yₖ′ = (∂F/∂y) yₖ + (∂F/∂p) pₖ.

    The state is (y, y₁, …, y_m), n(1 + m) numbers. Runs of it end as those of F do, once the
    derivatives of ω∞ are certain, too; `slopes` gives these. It is an equation as any other:
    simulate, classify or sweep it.

    Args:
        equation: the equation F, with a `verdict` if runs are to end.
        parameters: pₖ, the arrays of the equation (others None) with an axis of m in front.
        starts: the variations of ω₀, shape (m, 3).
        size: |ω₀|, by which changes of the start are measured.
    """

    slack: ClassVar[float] = 10.0
    """How many times as far off a variation may be, relative to its largest component.

    At the same tolerance derivatives are then less exact than values of the equation alone, but
    not next to a boundary. Those of bodies, whose precession gets out of phase, are the least:
    their errors grow with the turns of a run about as the square of these does."""

    equation: Any
    parameters: Any
    starts: Float[Array, "m 3 *lanes"]
    size: Real

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
        return value, self._apply(linear, variations)

    def _apply(self, function: Any, variations: list[Any]) -> list[Any]:
        """A function of all variations, those of the parameters and those of another point."""
        along = [jax.tree.map(lambda p, k=k: p[k], self.parameters) for k in range(self.m)]
        return [function(*pair) for pair in zip(along, variations, strict=True)]

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

    def sizes(self, y: State) -> State:
        """What the relative error of each component is measured by.

        That of a variation by its largest component, with some slack, or by a part of ω where
        that is larger: what is left after a cancellation is rounding.
        """
        state, *variations = self._split(y)
        own = sizes_of(self.equation)(state)
        least = LEAST * largest(jnp.abs(self.omega(y)))
        sizes = [
            jnp.maximum(self.slack * largest(jnp.abs(each)), least)[None] for each in variations
        ]
        return jnp.concatenate([own, *(jnp.broadcast_to(size, state.shape) for size in sizes)])

    @property
    def scales(self) -> Scales:
        """Those of the equation."""
        return scales_of(self.equation)

    def omega(self, y: State) -> Vector:
        """The angular velocity of a state."""
        return self.equation.omega(self._split(y)[0])

    def verdict(self, y: State) -> Verdict:
        """That of the equation, whose motions these are."""
        found = Verdict(*self.equation.verdict(self._split(y)[0]))
        own = found.belongs_to(self.equation)
        return found._replace(equation=type(self) if own else None)

    def slopes(self, y: State) -> Float[Array, "m *lanes"]:
        """The variations of ω∞, where the verdict on a state says that they are certain.

        A variation that takes the dipole off its principal axis ends all residual rotation: it is
        infinite if there is any, and else 0, whatever else varies. Infinite, too, is one that
        takes the state or the body from where alone ω∞ is what the verdict says.
        """
        state, *variations = self._split(y)
        value, changes = self._push(
            lambda equation, y: Verdict(*equation.verdict(y)).omega_inf, state, variations
        )
        slopes = jnp.stack(changes)
        slopes = jnp.where(infinite(slopes), jnp.inf, slopes)
        if isinstance(vars(self.equation).get("body"), Body):  # else the body is always a top
            lean, away = self._moved(state, variations)
            slopes = jnp.where(away, jnp.inf, slopes)
            ended = jnp.where(self._rotates(value, slopes), jnp.inf, 0.0)
            slopes = jnp.where(lean, ended[None], slopes)
        return slopes

    def _rotates(self, value: Real, slopes: Array) -> Bool[Array, "*lanes"]:
        """Whether there is a residual rotation that a leaning dipole ends."""
        return value != 0

    def astray(self, y: State, rtol: Real) -> Bool[Array, "*lanes"]:
        """Whether the variations are so large that a run within the tolerance may end elsewhere.

        Changes of the start count as far as rtol·|ω₀|, those of parameters, taken to be of the
        order of 1, as far as rtol.
        """
        state, *variations = (largest(jnp.abs(part)) for part in self._split(y))
        starts = largest(jnp.abs(jnp.moveaxis(self.starts, 1, 0)))
        away = [
            rtol * size * jnp.where(start > 0, self.size / jnp.where(start > 0, start, 1.0), 1.0)
            for size, start in zip(variations, starts, strict=True)
        ]
        return jnp.any(jnp.stack(away) >= state[None], axis=0)

    def _moved(self, state: State, variations: list[Any]) -> tuple[Array, Array]:
        """Which variations move, by more than rounding, each of the two `constraints`."""
        order = getattr(self.equation, "order", None)
        level = Level.SEMI if order is None else Level.of_order(order)

        def tied(equation: Any, y: State) -> Any:
            return constraints(equation.body, equation.omega(y), level)

        _, moved = self._push(tied, state, variations)
        sizes = self._apply(functools.partial(_relative, self.equation, state), variations)
        pairs = zip(moved, sizes, strict=True)
        found = [
            (_beyond(lean, body), _beyond(away, body + turn))
            for (lean, away), (body, turn) in pairs
        ]
        lean, away = map(jnp.stack, zip(*found, strict=True))
        return lean, away

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


def _relative(equation: Any, state: State, varied: Any, change: State) -> tuple[Real, Real]:
    """How large a variation is: of the body, and of its rotation."""
    pairs = (
        (equation.body.inertia, varied.body.inertia, (0, 1)),
        (equation.body.dipole, varied.body.dipole, (0,)),
        (equation.omega(state), equation.omega(change), (0,)),
    )
    inertia, dipole, omega = (
        jnp.max(jnp.abs(more), axis) / guarded(jnp.max(jnp.abs(of), axis))
        for of, more, axis in pairs
    )
    return inertia + dipole, omega


def _beyond(moved: Vector, size: Real) -> Bool[Array, "*lanes"]:
    """Whether it is more than rounding of terms of that size."""
    return jnp.max(jnp.abs(moved), axis=0) > rounding(size) * size


class Together(Tangent):
    """The same for one start and variations of single numbers: one piece of code for all.

    XLA compiles it in half the time, and runs it two to three times as fast. With many lanes side
    by side, and in the native engine, it is slower.
    """

    slack: ClassVar[float] = 3.0  # of one start, steps cost less than compilation

    def _apply(self, function: Any, variations: list[Any]) -> list[Any]:
        found = jax.vmap(function)(self.parameters, jnp.stack(variations))
        return [jax.tree.map(lambda x, k=k: x[k], found) for k in range(self.m)]

    def _rotates(self, value: Real, slopes: Array) -> Bool[Array, "*lanes"]:
        # Or may do so: a variation may come together with others that make the dipole rotate.
        return (value != 0) | jnp.any(slopes != 0, axis=0)

    def _moved(self, state: State, variations: list[Any]) -> tuple[Array, Array]:
        # Of a body that lies askew, aligned but for rounding, nearly every number turns the
        # dipole, and only the sum of all of them may tell that it does not.
        lean, away = super()._moved(state, variations)
        body = self.equation.body
        aligned = jnp.all(cross(body.dipole, matvec(body.inertia, body.dipole)) == 0, axis=0)
        return aligned & lean, away
