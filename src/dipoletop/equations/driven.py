"""An equation of motion with a torque that is added from outside."""

import inspect
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._base.attitudes import Quaternion, normalised, quaternion_rate
from .._base.checks import check_single, concrete, refuse
from .._base.linalg import inverse, matvec
from .._base.types import Equation, OmegaScale, State, Vector
from ..bodies import Body
from ._common import error_scale_of, is_full, omega_scale_of
from .levels import level_of

Torque = Callable[..., Vector]
"""M(τ, ω), or M(τ, ω, q) where the attitude is followed; shape (3,), in body axes."""


class OfFunction(eqx.Module):
    """A torque by a plain function, which holds no parameters that vary."""

    function: Torque = eqx.field(static=True)

    def __call__(self, t: Any, *state: Array) -> Vector:
        """The function's value."""
        return self.function(t, *state)


class Driven(eqx.Module):
    """ω′ = F(τ, ω) + I⁻¹M(τ, ω): an equation of motion with a torque M from outside.

    With an attitude the state is (ω, q), with q′ = ½ q∘(0, ω), and M may depend on q. The radiation
    torque in F is that of the motion without M: an error of the order of τ₀Ω, relative to M.

    `torques.with_torque` makes it and checks its arguments.
    """

    equation: Equation
    torque: Any
    inverse_inertia: Float[Array, "3 3 *lanes"]
    verdict: Callable[[State], Any] | None = eqx.field(static=True)
    start: Float[Array, "4 *lanes"] | None
    """The attitude at the start; None if it is not followed."""

    def __call__(self, t: Any, y: State, args: Any = None) -> State:
        """dy/dτ, shape (3,) or (7,), lanes (if any) behind."""
        omega = y[:3]
        attitude = () if self.start is None else (normalised(y[3:]),)
        torque = _in_lanes(self.torque, t, omega, *attitude)
        rate = self.equation(t, omega, args) + matvec(self.inverse_inertia, torque)
        return jnp.concatenate([rate, *(quaternion_rate(y[3:], omega) for _ in attitude)])

    def lift(self, omega0: Vector) -> State:
        """ω itself, or with the attitude at the start behind."""
        return omega0 if self.start is None else jnp.concatenate([omega0, self.start])

    def omega(self, y: State) -> Vector:
        """The first three components."""
        return y if self.start is None else y[:3]

    def attitude(self, y: State) -> Quaternion | None:
        """The unit quaternion of a state; None if the attitude is not followed."""
        return None if self.start is None else normalised(y[3:])

    @property
    def body(self) -> Body:
        """The body that the equation moves."""
        return self.equation.body  # pyright: ignore[reportAttributeAccessIssue]

    @property
    def level(self) -> str:
        """The label of the equation, and that a torque is added."""
        return f"{level_of(self.equation)}, with a torque"

    @property
    def omega_scale(self) -> OmegaScale:
        """That of the equation."""
        return omega_scale_of(self.equation)

    def error_scale(self, y: State) -> State:
        """That of the equation; errors of the attitude are angles."""
        own = error_scale_of(self.equation)(y[:3])
        return own if self.start is None else jnp.concatenate([own, jnp.ones_like(y[3:])])


def driven(
    equation: Equation, torque: Torque, verdict: Callable[[State], Any] | None, start: Array | None
) -> Driven:
    """The equation with a torque, its parts checked."""
    check_single(equation)
    if is_full(equation):
        must = "be of a reduced or the semi-reduced level (a torque has no physical branch)"
        refuse("equation", must, f"is {type(equation).__name__}")
    if getattr(equation, "body", None) is None:
        refuse("equation", "have a body, whose inertia the torque moves", "has none")
    if not callable(torque):
        refuse("torque", "be a function of τ and ω", f"is {torque!r}")
    if verdict is not None and not callable(verdict):
        refuse("verdict", "be a function of the state, or None", f"is {verdict!r}")
    if inspect.isroutine(torque):
        _check_constants(torque)
        torque = OfFunction(torque)
    body: Any = equation.body  # pyright: ignore[reportAttributeAccessIssue]
    return Driven(equation, torque, inverse(body.inertia), verdict, start)


def _check_constants(function: Any) -> None:
    """Refuse a function that holds traced numbers: they would leave their trace with it."""
    held = [cell.cell_contents for cell in getattr(function, "__closure__", None) or ()]
    if any(not concrete(leaf) for leaf in jax.tree.leaves(held)):
        must = "take parameters that vary as arguments (`jax.tree_util.Partial(f, gamma)`)"
        refuse("torque", must, "is a function that holds them")


def _in_lanes(torque: Torque, t: Any, omega: Vector, *attitude: Quaternion) -> Vector:
    """The torque of one top, or of each lane; then its arrays have a lane axis behind, too."""
    if omega.ndim == 1:
        return torque(t, omega, *attitude)
    arrays, rest = eqx.partition(torque, eqx.is_array)

    def of_lane(arrays: Any, t: Any, *state: Array) -> Vector:
        return eqx.combine(arrays, rest)(t, *state)

    times = 0 if jnp.ndim(t) else None
    axes = (-1, times, *(-1 for _ in (omega, *attitude)))
    return jax.vmap(of_lane, in_axes=axes, out_axes=-1)(arrays, t, omega, *attitude)
