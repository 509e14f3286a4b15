"""One trajectory, through diffrax: states, energies, powers, and the balance that checks them.

A full equation cannot be integrated forwards along its physical branch; `manifold` follows it.
"""

import functools
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jax.tree_util import Partial
from jaxtyping import Array, Float

from .. import radiation
from .._base.batches import over_batch
from .._base.checks import (
    FLAG,
    check_single,
    concrete,
    finite,
    initial_state,
    instance,
    is_whole_state,
    refuse,
    where_valid,
)
from .._base.forward_mode import forward_differentiable
from .._base.tolerances import MAX_STEPS, absolute, budget, tolerance
from .._base.types import Equation, State, Vector
from .._branch import march as manifold
from .._engines.step_sizes import Controller
from ..equations._common import sizes_of

LOST = (
    "The physical branch of the full equation could not be followed to the last time: "
    "ω is too large for a slow branch, or `max_steps` windows did not suffice."
)
ENDED = "The run ended before the last of `ts`: the solver's steps became too small, or failed."
OUT_OF_STEPS = "The run ended before the last of `ts`: `max_steps` did not suffice."
OPTIONS = {
    "solver": (diffrax.AbstractSolver, "be a solver of diffrax, such as `diffrax.Tsit5()`"),
    "stepsize_controller": (
        diffrax.AbstractStepSizeController,
        "be a step size controller of diffrax, such as `diffrax.PIDController(1e-8, 1e-10)`",
    ),
    "adjoint": (
        diffrax.AbstractAdjoint,
        "be an adjoint of diffrax, such as `diffrax.ForwardMode()`",
    ),
    "throw": (FLAG, "be True or False"),
    "dense": (FLAG, "be True or False"),
    "balance": (FLAG, "be True or False"),
}
"""What `simulate` takes besides its named arguments: the class, and what is to be said of it."""


class Followed(eqx.Module):
    """How a motion on the physical branch was found, in place of diffrax's `Solution`."""

    stats: dict[str, Any]
    """`num_steps`: windows solved for."""
    reached: Float[Array, ""]
    """The last time up to which the motion was found."""
    interpolation: None = None


def _batch_axes(run: Any) -> int:
    """The number of batch axes of a trajectory."""
    if run.ts.shape != run.ys.shape[:-1]:
        must = "have its batch axes in front of all its arrays, as `jax.vmap` puts them"
        refuse("trajectory", must, f"has ts of {run.ts.shape} and ys of {run.ys.shape}")
    return run.ts.ndim - 1


class Trajectory(eqx.Module):
    """A solution at the times asked for; energies and powers are computed when asked for.

    From `jax.vmap` every field and property has the batch axes in front.
    """

    equation: Any
    ts: Float[Array, "*batch T"]
    """Times τ, in units of τ₀."""
    ys: Float[Array, "*batch T n"]
    """States of the equation."""
    emitted: Float[Array, "*batch T"] | None
    """∫|d₂|²dτ, the energy radiated since the start; None unless `balance` was asked for."""
    solution: Any
    """diffrax's own solution: statistics, result, dense interpolation. Of a motion on the physical
    branch of a full equation a `Followed`."""

    @property
    @over_batch(_batch_axes)
    def omega(self) -> Float[Array, "*batch T 3"]:
        """Angular velocity in body axes, in units of 1/τ₀."""
        return jax.vmap(self.equation.omega)(self.ys)

    @property
    @over_batch(_batch_axes)
    def omega_dot(self) -> Float[Array, "*batch T 3"]:
        """Its rate."""
        return jax.vmap(functools.partial(_omega_dot, self.equation))(self.ts, self.ys)

    @property
    @over_batch(_batch_axes)
    def energy(self) -> Float[Array, "*batch T"]:
        """E = ½ Ω·IΩ."""
        return jax.vmap(lambda w: radiation.kinetic_energy(self.equation.body, w))(self.omega)

    @property
    @over_batch(_batch_axes)
    def power(self) -> Float[Array, "*batch T"]:
        """Radiated power |d₂|²."""
        power = functools.partial(radiation.radiated_power, self.equation.body)
        return jax.vmap(power)(self.omega, self.omega_dot)

    @property
    @over_batch(_batch_axes)
    def balance_defect(self) -> Float[Array, "*batch T"]:
        """[E − d₁·d₂ + ∫|d₂|²dτ] less its initial value, over the initial energy.

        Zero for the full equation, whatever the motion; a reduced level leaves a defect that
        says how far it is from the full equation.

        Raises:
            ValueError: the trajectory was computed without `balance=True`.
        """
        if self.emitted is None:
            refuse("balance", "be True in `simulate` for a balance defect", "was not")
        schott = functools.partial(radiation.schott_energy, self.equation.body)
        total = self.energy - jax.vmap(schott)(self.omega, self.omega_dot) + self.emitted
        start = self.energy[0]
        return (total - total[0]) / jnp.where(start > 0, start, 1.0)

    @property
    def stats(self) -> dict[str, Any]:
        """Steps: `num_steps`, `num_accepted_steps`, `num_rejected_steps`, ...."""
        return self.solution.stats

    @property
    def level(self) -> str:
        """Which level of the equation of motion this is."""
        return getattr(self.equation, "level", type(self.equation).__name__)

    def evaluate(self, t: Any) -> Float[Array, "..."]:
        """ω at any times within the run, by the solver's own interpolation (`dense=True`).

        Args:
            t: τ, of any shape.

        Returns:
            The components on the last axis, those of `t` before it, those of a batch in front.

        Raises:
            ValueError: the trajectory was computed without `dense=True`, or a time that is not
                within it. A traced one gives NaN.
        """
        if self.solution.interpolation is None:
            refuse("dense", "be True in `simulate` for values in between", "was not")
        times = finite("t", t, np.shape(t), batch=False)
        first, last = self.ts[..., 0].max(), self.ts[..., -1].min()
        inside = (times >= first) & (times <= last)
        times = where_valid("t", times, inside, "lie within the run")
        return self._between(times)

    @over_batch(_batch_axes)
    def _between(self, times: Float[Array, "..."]) -> Float[Array, "..."]:
        def at(time: Any) -> Vector:
            return self.equation.omega(self.solution.evaluate(time)[: self.ys.shape[-1]])

        return jax.vmap(at)(times.ravel()).reshape(*times.shape, 3)


def _omega_dot(equation: Any, t: Any, y: State) -> Vector:
    return jax.jvp(equation.omega, (y,), (equation(t, y, None),))[1]


def simulate(
    equation: Equation,
    omega0: Any,
    ts: Any,
    *,
    rtol: Any = 1e-10,
    atol: Any = None,
    max_steps: Any = MAX_STEPS,
    **options: Any,
) -> Trajectory:
    """Solve dy/dτ = equation(τ, y) with diffrax, from ω(ts[0]) = ω₀.

    May be jitted, vmapped and differentiated: in reverse as it is; forwards with
    `adjoint=diffrax.ForwardMode()`; along a physical branch in both ways.

    Args:
        equation: any equation of motion.
        omega0: start ω₀, shape (3,), dimensionless, body axes; a full equation is then followed
            along its physical branch. Or a whole state of a full equation, which is taken as
            given, and runs away unless it lies on that branch.
        ts: times at which the state is wanted, shape (T,), increasing; the first is the start.
        rtol: relative tolerance.
        atol: absolute tolerance; None means none: errors are measured by the present |ω|.
        max_steps: budget.
        options: `solver` (`diffrax.Dopri8()`), `stepsize_controller`
            (`diffrax.PIDController(rtol, atol)` with errors measured by the present |ω|) and
            `adjoint` are passed to diffrax; `throw=False` returns what there is, and NaN
            for the rest, instead of raising (then there are no derivatives in reverse);
            `dense=True` keeps the interpolation; `balance=True` integrates the radiated energy
            beside the state.

    Returns:
        A `Trajectory`.

    Raises:
        ValueError: bad arguments, among them an option of another name.
        RuntimeError: the run did not reach the last of `ts` (unless `throw=False`).

    Example:
        >>> import jax.numpy as jnp, dipoletop as dt
        >>> rotator = dt.simulate(dt.TransverseReduced(0.3), [0.0, 1.0, 0.0], jnp.array([0.0, 4.0]))
        >>> bool(abs(rotator.omega[-1, 1] - 1 / 3) < 1e-9)  # Ω₀/√(1 + 2Ω₀²τ), equation (2.4)
        True
    """
    check_single(equation)
    _check_options(options)
    whole = is_whole_state(omega0)
    if not whole:
        equation = manifold.physical(equation)
    times = _times(ts)
    state = initial_state(equation, omega0)
    rtol = tolerance("rtol", rtol)
    scale = absolute(atol, rtol, equation.omega(state))
    steps = budget("max_steps", max_steps)
    if manifold.is_full(equation) and not whole:
        run = _follow(equation, state, times, rtol, steps, options)
        failures = {LOST: ~(run.solution.reached >= times[-1])}
    else:
        run = _solve(equation, state, times, (rtol, scale), steps, options)
        result = run.solution.result
        out = result == diffrax.RESULTS.max_steps_reached
        failures = {OUT_OF_STEPS: out, ENDED: ~(diffrax.is_successful(result) | out)}
    return _raised(run, failures) if options.get("throw", True) else run


def _raised(run: Trajectory, failures: dict[str, Any]) -> Trajectory:
    """The trajectory, unless it failed; of a traced one equinox raises, later."""
    for sentence, failed in failures.items():
        if concrete(failed) and failed:
            raise RuntimeError(sentence)
        if not concrete(failed):
            states = eqx.error_if(run.ys, failed, sentence)
            run = eqx.tree_at(lambda run: run.ys, run, states)
    return run


def _check_options(options: dict[str, Any]) -> None:
    for name, value in options.items():
        if name not in OPTIONS:
            refuse("options", f"be among {', '.join(OPTIONS)}", f"one is `{name}`")
        kind, must = OPTIONS[name]
        if value is not None or kind is FLAG:
            instance(name, value, kind, must)


def _times(ts: Any) -> Float[Array, "T"]:
    times = finite("ts", ts, (-1,), batch=False)
    if times.shape[0] < 2:
        refuse("ts", "hold at least two times, the start first", f"has shape {times.shape}")
    return where_valid("ts", times, jnp.all(jnp.diff(times) > 0), "increase")


def _follow(equation, state, times, rtol, max_windows: int, options) -> Trajectory:
    """Along the physical branch of a full equation."""
    for name in ("solver", "stepsize_controller", "adjoint", "dense"):
        if options.get(name):
            refuse(
                "options",
                "be `throw` or `balance` for a start of shape (3,) of a full equation, whose "
                "physical branch diffrax cannot follow (give a whole state for the vector field)",
                f"one is `{name}`",
            )
    motion = _motion(equation, equation.omega(state), times, rtol, max_windows)
    # The rates, for derivatives with respect to the times.
    later = times - times[0]
    later = later - jax.lax.stop_gradient(later)
    states = motion.states + jax.vmap(equation)(times, motion.states) * later[:, None]
    emitted = motion.emitted if options.get("balance", False) else None
    found = Followed({"num_steps": motion.windows}, motion.reached)
    return Trajectory(equation, times, states, emitted, found)


def _motion(equation, omega, times, rtol, max_windows: int) -> manifold.Motion:
    """`manifold.follow`, differentiable in reverse, too, with respect to equation and start."""
    arrays, rest = eqx.partition(equation, eqx.is_inexact_array)
    x, back = ravel_pytree((arrays, omega))

    def follow(x: Array, settings: Any) -> manifold.Motion:
        arrays, omega = back(x)
        times, rtol = settings
        body = eqx.combine(arrays, rest)
        motion = manifold.follow(body, omega, times, rtol, max_windows)
        return motion._replace(windows=motion.windows.astype(x.dtype))

    settings = times, rtol
    kinds = jax.eval_shape(follow, x, settings)
    _, apart = ravel_pytree(jax.tree.map(lambda kind: jnp.zeros(kind.shape, kind.dtype), kinds))
    motion = apart(forward_differentiable(lambda x, s: ravel_pytree(follow(x, s))[0])(x, settings))
    return motion._replace(windows=motion.windows.astype(int))


def _sizes(equation: Any, y: State) -> State:
    """What errors are measured by; the radiated energy, if it is there, goes as the square of ω."""
    n = jax.eval_shape(equation.lift, jnp.zeros(3, y.dtype)).shape[0]
    least = jnp.max(jnp.abs(equation.omega(y[:n]))) ** 2
    return jnp.concatenate([sizes_of(equation)(y[:n]), jnp.maximum(jnp.abs(y[n:]), least)])


@eqx.filter_jit
def _solve(equation, y0, times, tolerances, max_steps: int, options) -> Trajectory:
    rtol, atol = tolerances
    n = y0.shape[0]
    balance = options.get("balance", False)

    def field(t, y, args):
        rate = equation(t, y[:n], args)
        if not balance:
            return rate
        omega = equation.omega(y[:n])
        power = radiation.radiated_power(equation.body, omega, _omega_dot(equation, t, y[:n]))
        return jnp.concatenate([rate, power[None]])

    controller = options.get("stepsize_controller")
    if controller is None:
        controller = Controller(rtol, atol, Partial(_sizes, equation))
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(field),
        options.get("solver") or diffrax.Dopri8(),
        times[0],
        times[-1],
        None,
        jnp.concatenate([y0, jnp.zeros(1)]) if balance else y0,
        saveat=diffrax.SaveAt(ts=times, dense=options.get("dense", False)),
        stepsize_controller=controller,
        adjoint=options.get("adjoint") or diffrax.RecursiveCheckpointAdjoint(),
        max_steps=max_steps,
        throw=False,
    )
    ys: Any = solution.ys
    # What was not reached has no derivative, either: diffrax's constant inf would have 0. (A factor
    # of what depends on everything: `where` would spoil derivatives in reverse of whole runs, too.)
    everything = jnp.sum(y0) + jnp.sum(equation(times[0], y0, None))
    ys = ys + jnp.where(jnp.isfinite(ys), 0.0, jnp.nan) * everything
    return Trajectory(equation, times, ys[:, :n], ys[:, n] if balance else None, solution)
