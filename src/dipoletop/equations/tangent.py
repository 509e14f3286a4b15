"""An equation together with its first variations, as one equation."""

import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .._base.guards import rounding, safe_divisor
from .._base.linalg import cross, largest, matvec
from .._base.shown import Shown
from .._base.stopping import prepared_verdicts, verdict_on
from .._base.tolerances import TANGENT_FLOOR, TANGENT_SLACK
from .._base.types import DecidingEquation, Flag, OmegaScale, Real, State, Vector, Verdict
from ._common import error_scale_of, has_body_field, jumps_of, omega_scale_of
from ._verdicts.dipole_frame import constraints
from ._verdicts.nonsmooth import infinite
from .levels import Level, level_of


class Tangent(Shown):
    """y′ = F(p, y) with m first variations of it, yₖ′ = (∂F/∂y) yₖ + (∂F/∂p) pₖ.

    The state is (y, y₁, …, y_m), n(1 + m) numbers. It is an equation like any other: simulate,
    classify or sweep it. Its runs end like the runs of F, once the derivatives of ω∞ are certain,
    too; `omega_inf_tangents` gives these.

    Args:
        equation: the equation F.
        parameter_variations: pₖ, the arrays of the equation (others None) with an axis of m in
            front.
        start_variations: the variations of ω₀, shape (m, 3).
        start_size: |ω₀|, to which `start_variations` are compared.
        basis: whether the variations are unit changes of single numbers whose linear combinations
            are wanted (a gradient), instead of independent directions. For one lane they are then
            batched by `jax.vmap`: XLA compiles that in half the time and runs it two to three
            times as fast. For many lanes, and in the native engine, unrolled variations are faster.
        tangent_slack: the factor by which the relative error of a variation may exceed the
            relative error of the state.
        varying: for each variation, which leaves of `parameter_variations` are not 0 throughout;
            None: any may differ from 0. Terms of leaves that are 0 are left out, up to a quarter
            of the operations.
    """

    equation: DecidingEquation
    parameter_variations: Any
    start_variations: Float[Array, "m 3 *lanes"]
    start_size: Real
    basis: bool = eqx.field(static=True, default=False)
    tangent_slack: float = eqx.field(static=True, default=TANGENT_SLACK)
    varying: tuple[tuple[bool, ...], ...] | None = eqx.field(static=True, default=None)

    def __call__(self, t: Any, y: State, args: Any = None) -> State:
        """Return the rates of the state and of its variations."""
        state, *variations = self._split(y)
        rate, rates = self._linearised(lambda equation, y: equation(t, y, args), state, variations)
        return jnp.concatenate([rate, *rates])

    def lift(self, omega0: Vector) -> State:
        """Return the initial state at `omega0`, with its variations."""
        state, variations = self._linearised(
            lambda equation, omega: equation.lift(omega), omega0, list(self.start_variations)
        )
        return jnp.concatenate([state, *variations])

    def omega(self, y: State) -> Vector:
        """Return the angular velocity of a state."""
        return self.equation.omega(self._split(y)[0])

    def prepare(self) -> Any:
        """Return the result of `equation.prepare`, or None."""
        return prepared_verdicts(self.equation)

    def verdict(self, y: State, prepared: Any = None) -> Verdict:
        """Return the verdict of the equation on the state without its variations."""
        verdict = verdict_on(self.equation, self._split(y)[0], prepared)
        own = verdict.belongs_to(self.equation)
        return verdict._replace(equation=Tangent if own else None)

    @property
    def m(self) -> int:
        """The number of variations."""
        return self.start_variations.shape[0]

    @property
    def level(self) -> str:
        """The label of the equation."""
        return level_of(self.equation)

    @property
    def body(self) -> Any:
        """The body that the equation moves; None if it names none."""
        return getattr(self.equation, "body", None)

    @property
    def runaway_rate(self) -> Any:
        """The runaway rate of a full equation, else None."""
        return getattr(self.equation, "runaway_rate", None)

    @property
    def jumps(self) -> Any:
        """The times at which a torque of the equation jumps, or None."""
        return jumps_of(self.equation)

    @property
    def omega_scale(self) -> OmegaScale:
        """The scale of the error of ω of the equation."""
        return omega_scale_of(self.equation)

    def error_scale(self, y: State) -> State:
        """Return the scale of the error of each component.

        For a variation it is the largest component times `tangent_slack`, but at least a fraction
        of |ω|, since after a cancellation only rounding is left.
        """
        state, *variations = self._split(y)
        own = error_scale_of(self.equation)(state)
        floor = TANGENT_FLOOR * largest(jnp.abs(self.omega(y)))
        scales = [
            jnp.maximum(self.tangent_slack * largest(jnp.abs(variation)), floor)[None]
            for variation in variations
        ]
        return jnp.concatenate([own, *(jnp.broadcast_to(scale, state.shape) for scale in scales)])

    def may_cross_boundary(self, y: State, rtol: Real) -> Flag:
        """Return whether changes within the tolerance may take the state to another outcome.

        Changes of ω₀ count up to rtol·|ω₀|, changes of parameters, taken to be of order 1, up to
        rtol. The outcome may change if the linearised change of the state is as large as the state.
        """
        state, *variations = (largest(jnp.abs(part)) for part in self._split(y))
        starts = largest(jnp.abs(jnp.moveaxis(self.start_variations, 1, 0)))
        changes = [
            rtol
            * size
            * jnp.where(start > 0, self.start_size / jnp.where(start > 0, start, 1.0), 1.0)
            for size, start in zip(variations, starts, strict=True)
        ]
        return jnp.any(jnp.stack(changes) >= state[None], axis=0)

    def omega_inf_tangents(self, y: State) -> Float[Array, "m *lanes"]:
        """Return the variations of ω∞, where the verdict on a state says that they are certain.

        A variation that takes the dipole off its principal axis ends all residual rotation: the
        derivative is infinite if ω∞ ≠ 0, else 0, whatever else varies. The derivative is also
        infinite if the variation leaves the set on which the value of ω∞ holds.
        """
        state, *variations = self._split(y)
        value, changes = self._linearised(
            lambda equation, y: Verdict(*equation.verdict(y)).omega_inf, state, variations
        )
        tangents = jnp.stack(changes)
        tangents = jnp.where(infinite(tangents), jnp.inf, tangents)
        if has_body_field(self.equation):  # any other body remains a top
            leans, leaves = self._broken_constraints(state, variations)
            tangents = jnp.where(leaves, jnp.inf, tangents)
            rotates = value != 0
            if self.basis:  # a combination with other variations may make the top rotate
                rotates = rotates | jnp.any(tangents != 0, axis=0)
            ended = jnp.where(rotates, jnp.inf, 0.0)
            tangents = jnp.where(leans, ended[None], tangents)
        return tangents

    def _broken_constraints(self, state: State, variations: list[Array]) -> tuple[Array, Array]:
        """Return which variations break, by more than rounding, each of the two `constraints`."""
        order = getattr(self.equation, "order", None)
        level = Level.SEMI if order is None else Level.of_order(order)

        def constrained(equation: Any, y: State) -> Any:
            return constraints(equation.body, equation.omega(y), level)

        _, moved = self._linearised(constrained, state, variations)
        sizes = self._of_variations(
            lambda _, *varied: _sizes(self.equation, state, *varied), variations
        )
        broken = [
            (_exceeds(lean, body), _exceeds(away, body + omega))
            for (lean, away), (body, omega) in zip(moved, sizes, strict=True)
        ]
        leans, leaves = map(jnp.stack, zip(*broken, strict=True))
        if self.basis:
            # If the principal axes are not the body axes, nearly every single number turns the
            # dipole; only the sum of all changes shows that it stays on its axis.
            body: Any = self.body
            aligned = jnp.all(cross(body.dipole, matvec(body.inertia, body.dipole)) == 0, axis=0)
            leans = aligned & leans
        return leans, leaves

    def _split(self, y: State) -> list[Array]:
        """Return the state of the equation and its variations."""
        n = y.shape[0] // (1 + self.m)
        return [y[n * k : n * (k + 1)] for k in range(1 + self.m)]

    def _linearised(
        self, function: Callable[[Any, Array], Any], point: Array, variations: list[Array]
    ) -> tuple[Any, list[Any]]:
        """Return function(equation, point): its value and its variations."""
        arrays, rest = eqx.partition(self.equation, eqx.is_inexact_array)
        masks = self._masks(arrays)

        @functools.cache  # variations of the same arrays share one linear map
        def linearised(mask: tuple[bool, ...]) -> tuple[Any, Any]:
            moving, fixed = eqx.partition(arrays, _unflatten(mask, arrays))

            def varied(moving: Any, point: Array) -> Any:
                return function(eqx.combine(moving, fixed, rest), point)

            return jax.linearize(varied, moving, point)

        def change(k: int, parameters: Any, variation: Array) -> Any:
            _, linear = linearised(masks[k])
            return linear(eqx.filter(parameters, _unflatten(masks[k], arrays)), variation)

        value, _ = linearised(masks[0])
        return value, self._of_variations(change, variations)

    def _masks(self, arrays: Any) -> list[tuple[bool, ...]]:
        """Return which arrays of the equation each variation changes; the same for a `basis`."""
        every = (True,) * len(jax.tree.leaves(arrays))
        masks = list(self.varying or [every] * self.m)
        if self.basis:
            masks = [tuple(map(any, zip(*masks, strict=True)))] * self.m
        return masks

    def _of_variations(
        self, function: Callable[[int, Any, Array], Any], variations: list[Array]
    ) -> list[Any]:
        """Return function(k, parameter variation, variation of a point), k from 0 to m − 1.

        For a `basis`, whose function is the same for every k, they are computed all at once.
        """
        if self.basis:
            images = jax.vmap(functools.partial(function, 0))(
                self.parameter_variations, jnp.stack(variations)
            )
            return [jax.tree.map(lambda x, k=k: x[k], images) for k in range(self.m)]
        parameters = [
            jax.tree.map(lambda p, k=k: p[k], self.parameter_variations) for k in range(self.m)
        ]
        return [
            function(k, *pair) for k, pair in enumerate(zip(parameters, variations, strict=True))
        ]


def _unflatten(mask: tuple[bool, ...], arrays: Any) -> Any:
    """Return the mask as a pytree like `arrays`."""
    return jax.tree.unflatten(jax.tree.structure(arrays), mask)


def _sizes(equation: Any, state: State, varied: Any, change: State) -> tuple[Real, Real]:
    """Return the relative sizes of a variation of the body and of its rotation."""
    pairs = (
        (equation.body.inertia, varied.body.inertia, (0, 1)),
        (equation.body.dipole, varied.body.dipole, (0,)),
        (equation.omega(state), equation.omega(change), (0,)),
    )
    inertia, dipole, omega = (
        jnp.max(jnp.abs(variation), axis) / safe_divisor(jnp.max(jnp.abs(value), axis))
        for value, variation, axis in pairs
    )
    return inertia + dipole, omega


def _exceeds(moved: Vector, size: Real) -> Bool[Array, "*lanes"]:
    """Return whether a change exceeds the rounding of terms of the given size."""
    return jnp.max(jnp.abs(moved), axis=0) > rounding(size) * size
