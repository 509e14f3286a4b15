"""Rigid bodies with a torque M from outside, at every level.

The equation of motion is IΩ̇ + N − M = T(Ω, Ω̇, Ω̈): the load N − M replaces N of `rigid`. At a
reduced level the Ω̇ and Ω̈ in the radiation torque T include the effect of M, so that a dipole
which only M accelerates radiates, too.
"""

import abc
import functools
import inspect
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.tree_util import Partial
from jaxtyping import Array, Float

from .._base.attitudes import Quaternion, normalised, quaternion_rate
from .._base.checks import check_single, concrete
from .._base.linalg import inverse, matvec
from .._base.refusals import refuse
from .._base.shown import Shown
from .._base.types import OmegaScale, Real, State, Vector
from ..bodies import Body
from ..radiation import gyroscopic_torque
from ._common import OmegaFirst, omega_scale_of, slow_start
from ._families import LONGITUDINAL, RIGID, TRANSVERSE
from .levels import WITH_TORQUE, Level
from .rigid import (
    across_dipole,
    full_fast_rate,
    full_rate,
    reduced_rate,
    runaway_rate,
    semi_reduced_rate,
)

Torque = Callable[..., Vector]
"""M(τ, ω), or M(τ, ω, q) where the attitude is followed; shape (3,), in body axes."""
Slow = Float[Array, "m *lanes"]
"""ω, or (ω, q) where the attitude is followed."""


class Loaded(Shown):
    """A body with torques, and the rates of its slow state (ω, or (ω, q)) at each level."""

    body: Body
    parts: tuple[Any, ...]
    """The torques."""
    follow: tuple[bool, ...] = eqx.field(static=True)
    """Whether each depends on the attitude."""

    def torque(self, t: Any, slow: Slow) -> Vector:
        """Return M, the sum of the torques."""
        total = jnp.zeros_like(slow[:3])
        for part, follows in zip(self.parts, self.follow, strict=True):
            attitude = (normalised(slow[3:]),) if follows else ()
            total = total + _in_lanes(part, t, slow[:3], *attitude)
        return total

    def load(self, t: Any, slow: Slow) -> Vector:
        """Return N − M."""
        return gyroscopic_torque(self.body, slow[:3]) - self.torque(t, slow)

    def with_attitude(self, rate: Vector, slow: Slow) -> Slow:
        """Return Ω̇, followed by q̇ if q belongs to the slow state."""
        turning = [quaternion_rate(slow[3:], slow[:3])] if slow.shape[0] > 3 else []
        return jnp.concatenate([rate, *turning])

    def rates(self, order: int | None, t: Any, slow: Slow) -> Slow:
        """Return the rates at a reduced level, or at the semi-reduced one (None).

        Order 0 is the motion without radiation, IΩ̇ = M − N.
        """
        omega, load = slow[:3], self.load(t, slow)
        if order == 0:
            return self.with_attitude(-matvec(inverse(self.body.inertia), load), slow)
        lower = 0 if order is None else order - 1

        first, derivative = jax.linearize(functools.partial(self.rates, lower), t, slow)
        second = derivative(jnp.ones_like(t), first)
        if order is None:
            rate = semi_reduced_rate(self.body, omega, second[:3], load)
        else:
            rate = reduced_rate(self.body, omega, (first[:3], second[:3]), load)
        return self.with_attitude(rate, slow)


class DrivenEquation(OmegaFirst):
    """The members that equations with torques from outside share.

    With an attitude the state begins with (ω, q), q̇ = ½ q∘(0, ω), and the torques may depend on q.
    """

    loaded: Loaded
    kind: Level = eqx.field(static=True)
    """The level of the equation."""
    verdict: Callable[[State], Any] | None = eqx.field(static=True)
    start: Float[Array, "4 *lanes"] | None
    """The attitude at the start; None if it is not followed."""
    jumps: Float[Array, "j *lanes"] | None
    """The times at which a torque jumps, ascending, or None."""

    @abc.abstractmethod
    def __call__(self, t: Any, y: State, args: Any = None) -> State:
        """Return dy/dτ."""

    @abc.abstractmethod
    def lift(self, omega0: Vector) -> State:
        """Return the state at the start."""

    def attitude(self, y: State) -> Quaternion | None:
        """Return the unit quaternion of a state; None if the attitude is not followed."""
        return None if self.start is None else normalised(y[3:7])

    def torque(self, t: Any, y: State) -> Vector:
        """Return M at a state."""
        return self.loaded.torque(t, y[: 3 if self.start is None else 7])

    @property
    def body(self) -> Body:
        """The body that the equation moves."""
        return self.loaded.body

    @property
    def level(self) -> str:
        """The label of the level, with `WITH_TORQUE`."""
        return self.kind.label + WITH_TORQUE


class Driven(DrivenEquation):
    """A reduced or the semi-reduced equation with torques from outside; see `torques.with_torque`.

    The state is ω, or (ω, q).
    """

    omega_scale: OmegaScale = eqx.field(static=True)
    """The scale of the error of ω of the equation without torques."""

    def __call__(self, t: Any, y: State, args: Any = None) -> State:
        """Return dy/dτ, shape (3,) or (7,), lanes (if any) behind."""
        return self.loaded.rates(self.kind.order, jnp.asarray(t, y.dtype), y)

    def lift(self, omega0: Vector) -> State:
        """Return ω₀, followed by the initial attitude if that is followed."""
        return slow_start(self, omega0)

    def error_scale(self, y: State) -> State:
        """Return the scale of ω; errors of the attitude are angles."""
        return jnp.concatenate([self.omega_scale(y[:3]), jnp.ones_like(y[3:])])


class DrivenFull(DrivenEquation):
    """The full equation with torques from outside; see `torques.with_torque`.

    The state is (ω, a), or (ω, q, a) with an attitude, and a = PΩ̇ as in `Full`, which serves for
    bodies of every kind.
    """

    @property
    def elements(self) -> int:
        """The number of elements of a window."""
        # A body may swing to and fro while a runaway dies away, and before a jump it begins to
        # move as a runaway does.
        return 8 if self.jumps is None else 16

    def __call__(self, t: Any, y: State, args: Any = None) -> State:
        """Return dy/dτ, shape (6,) or (10,), lanes (if any) behind."""
        loaded, slow, a = self.loaded, y[:-3], y[-3:]
        load = loaded.load(jnp.asarray(t, y.dtype), slow)
        rate = full_rate(loaded.body, a, load)
        fast = full_fast_rate(loaded.body, slow[:3], rate, load)
        return jnp.concatenate([loaded.with_attitude(rate, slow), fast])

    def lift(self, omega0: Vector) -> State:
        """Compute the state near the physical branch at τ = 0, by the reduction of order 3."""
        slow = slow_start(self, omega0)
        rate = self.reduced(3)(jnp.zeros((), slow.dtype), slow)
        return jnp.concatenate([slow, self.fast(rate[:3])])

    def fast(self, omega_dot: Vector) -> Vector:
        """Return the fast part of Ω̇, which is a part of the state."""
        return across_dipole(self.body, omega_dot)

    def reduced(self, order: int) -> Callable[[Any, Slow], Slow]:
        """Return the rates of (ω, q) at a reduced level."""
        return functools.partial(self.loaded.rates, order)

    @property
    def semi(self) -> Callable[[Any, Slow], Slow]:
        """The rates of (ω, q) at the semi-reduced level."""
        return functools.partial(self.loaded.rates, None)

    @property
    def runaway_rate(self) -> Real:
        """The runaway rate without torques. A torque that drives ω away from rest decreases it."""
        return runaway_rate(self.body)


def driven(
    equation: Any,
    torque: Torque,
    verdict: Callable[[State], Any] | None,
    start: Array | None,
    jumps: Array | None,
) -> Driven | DrivenFull:
    """Return the equation with a torque, its parts checked."""
    check_single(equation)
    if not callable(torque):
        refuse("torque", "be a function of τ and ω", f"is {torque!r}")
    if verdict is not None and not callable(verdict):
        refuse("verdict", "be a function of the state, or None", f"is {verdict!r}")
    if inspect.isroutine(torque):
        _check_constants(torque)
        torque = Partial(torque)  # which holds no parameters that vary
    follows = start is not None or getattr(equation, "start", None) is not None
    _check_result(torque, follows)
    parts, follow = (torque,), (follows,)
    if isinstance(equation, DrivenEquation):  # the torque is added to its torques
        if start is not None and equation.start is not None:
            refuse("attitude", "be None, as `equation` has one", "is another one")
        before, body, kind = equation.loaded, equation.body, equation.kind
        parts, follow = (*before.parts, *parts), (*before.follow, *follow)
        start = equation.start if start is None else start
        given = [x for x in (equation.jumps, jumps) if x is not None]
        jumps = jnp.concatenate(given) if given else None
    elif type(equation) in RIGID + TRANSVERSE + LONGITUDINAL:  # a subclass may have other rates
        body, kind = equation.body, Level.labelled(equation.level)
    else:
        must = "be a level of a rigid body, such as `TransverseSemi` or `SemiReduced`"
        refuse("equation", must, f"is {type(equation).__name__}")
    jumps = None if jumps is None else jax.lax.stop_gradient(jnp.sort(jumps))
    shared = Loaded(body, parts, follow), kind, verdict, start, jumps
    if kind is Level.FULL:
        return DrivenFull(*shared)
    return Driven(*shared, omega_scale_of(equation))


def _check_result(torque: Torque, follows: bool) -> None:
    """Refuse a torque with other arguments, or with a result of another shape."""
    arguments = [jnp.zeros(()), jnp.zeros(3), *([jnp.zeros(4)] if follows else [])]
    listed = "(τ, ω, q)" if follows else "(τ, ω)"
    try:
        inspect.signature(torque).bind(*arguments)
    except (TypeError, ValueError) as error:
        refuse("torque", f"take the arguments {listed}", f"cannot ({error})")
    found = jax.eval_shape(torque, *arguments)
    if getattr(found, "shape", None) != (3,):
        was = getattr(found, "shape", type(found).__name__)
        refuse("torque", f"return an array of shape (3,) for {listed}", f"returns {was}")


def _check_constants(function: Any) -> None:
    """Refuse a function that holds traced numbers, which would leak out of their trace."""
    held = [cell.cell_contents for cell in getattr(function, "__closure__", None) or ()]
    if any(not concrete(leaf) for leaf in jax.tree.leaves(held)):
        must = "take parameters that vary as arguments (`jax.tree_util.Partial(f, gamma)`)"
        refuse("torque", must, "is a function that holds them")


def _in_lanes(torque: Torque, t: Any, omega: Vector, *attitude: Quaternion) -> Vector:
    """Return the torque of one top, or of each lane; arrays of `torque` then have a lane axis."""
    if omega.ndim == 1:
        return torque(t, omega, *attitude)
    arrays, rest = eqx.partition(torque, eqx.is_array)

    def of_lane(arrays: Any, t: Any, *state: Array) -> Vector:
        return eqx.combine(arrays, rest)(t, *state)

    times = 0 if jnp.ndim(t) else None
    axes = (-1, times, *(-1 for _ in (omega, *attitude)))
    return jax.vmap(of_lane, in_axes=axes, out_axes=-1)(arrays, t, omega, *attitude)
