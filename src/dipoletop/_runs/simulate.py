"""One simulation, through diffrax or along the physical branch of a full equation.

A full equation cannot be integrated forwards along its physical branch, since every error grows as
fast as the runaway solutions do. `_branch.march` follows that branch instead.
"""

import functools
import inspect
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Unpack

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jax.tree_util import Partial
from jaxtyping import Array, Float

from .._base.attitudes import (
    attitude_after,
    no_turn,
    product,
    quaternion_rate,
    turn_rate,
    unit_quaternion,
)
from .._base.checks import (
    ArrayLike,
    NumberLike,
    check_body,
    check_single,
    checked_start,
    concrete,
    finite,
    is_whole_state,
    on_host,
    where_valid,
)
from .._base.compiling import compiled_soon
from .._base.forward_mode import forward_differentiable
from .._base.refusals import refusal, refuse
from .._base.structure import state_of
from .._base.tolerances import MAX_STEPS, Tolerances, budget, step_tolerances
from .._base.types import Equation, State, Vector
from .._branch import march
from .._engines.step_sizes import Controller, ending_at_jumps
from ..equations._common import (
    OfOmega,
    energy_flows,
    error_scale_of,
    follows_attitude,
    is_full,
    physical,
    twist_axis,
)
from .solver_options import Options, check_branch_options, check_options, event_of, saved_at
from .trajectory import BranchSolution, Trajectory

BRANCH_LOST = (
    "The physical branch of the full equation could not be followed to the last time: "
    "ω is too large for a slow branch, a torque too fast, or `max_steps` = {} windows did not "
    "suffice."
)
STEP_FAILED = (
    "The run ended before the last of `ts`: the solver's steps became too small, or failed."
)
OUT_OF_STEPS = "The run ended before the last of `ts`: `max_steps` = {} steps did not suffice."


def simulate(
    equation: Equation | Callable[..., Any],
    omega0: ArrayLike,
    ts: ArrayLike,
    *,
    rtol: NumberLike = 1e-10,
    atol: NumberLike | None = None,
    max_steps: int | np.integer = MAX_STEPS,
    **options: Unpack[Options],
) -> Trajectory:
    """Solve dy/dτ = equation(τ, y) with diffrax, from ω(ts[0]) = ω₀.

    May be jitted, vmapped and differentiated: in reverse mode by default; in forward mode with
    `adjoint=diffrax.ForwardMode()`; along a physical branch in both modes.

    | option | meaning | default |
    |---|---|---|
    | `solver` | a solver of diffrax | `diffrax.Dopri8()` |
    | `stepsize_controller` | a step size controller of diffrax | PID by `rtol`, `atol`, |ω(τ)| |
    | `dt0` | the first step; the step of `diffrax.ConstantStepSize()` | chosen by diffrax |
    | `event` | ends the run, `diffrax.Event(condition)`, with condition(τ, y, args) | None |
    | `saveat` | what is saved in place of `ts`: `diffrax.SaveAt(steps=True)`, … | None |
    | `progress_meter` | a progress meter of diffrax | none |
    | `adjoint` | how diffrax differentiates | `diffrax.RecursiveCheckpointAdjoint()` |
    | `throw` | raise if the run ends early, else fill up with NaN | True |
    | `dense` | keep the interpolation, for `Trajectory.evaluate` | False |
    | `balance` | integrate the radiated energy, too | False |
    | `attitude` | the attitude at ts[0], shape (4,); integrate dq/dτ = ½ q∘(0, ω), too | None |

    With `throw=False` a run that ends early has no derivatives in reverse mode. After an event all
    times and states equal the event's. With `saveat` the trajectory holds the times that are
    saved; in a trace, unused places hold inf for the time and NaN for the state.

    Args:
        equation: any equation of motion; or a plain function (τ, ω, args) that gives dω/dτ.
        omega0: start ω₀, shape (3,), dimensionless, body axes; a full equation is then followed
            along its physical branch. Or a whole state of a full equation, which is integrated as
            given, and runs away unless it lies on that branch.
        ts: times at which the state is wanted, shape (T,), increasing, T ≥ 2; ω₀ belongs to the
            first.
        rtol: relative tolerance of every step.
        atol: absolute tolerance of every step; None means 0, since errors are measured by the
            present |ω|.
        max_steps: largest number of steps, or of windows along a physical branch; with
            `attitude` also of the pieces of 2 radians there.
        options: see the table; along a physical branch only `throw`, `balance` and `attitude`. An
            attitude is a unit quaternion, scalar first, with v_lab = q∘v∘q* for v in body axes. If
            the equation follows an attitude, it replaces the first one of the equation: so a run
            goes on from the last ω and attitude of another one.

    Returns:
        A `Trajectory`.

    Raises:
        ValueError: bad arguments, or an unknown option.
        RuntimeError: the run did not reach the last of `ts` (unless `throw=False`).

    Example:
        >>> import jax.numpy as jnp, dipoletop as dt
        >>> rotator = dt.simulate(dt.TransverseReduced(0.3), [0.0, 1.0, 0.0], jnp.array([0.0, 4.0]))
        >>> bool(abs(rotator.omega[-1, 1] - 1 / 3) < 1e-9)  # Ω₀/√(1 + 2Ω₀²τ), equation (2.4)
        True
    """
    motion: Any = _PlainFunction(equation) if inspect.isroutine(equation) else equation
    check_single(motion)
    check_options(options)
    if options.get("balance"):
        check_body(physical(motion))
    given = options.pop("attitude", None)
    q0 = None if given is None else unit_quaternion("attitude", given)
    whole_state = is_whole_state(omega0)
    if q0 is not None and follows_attitude(motion):
        if whole_state:
            refuse("attitude", "be None for a whole state, which holds the attitude", "is given")
        motion, q0 = eqx.tree_at(lambda equation: equation.start, motion, q0), None
    if not whole_state:
        motion = physical(motion)
    times = _times(ts)
    start = checked_start(motion, omega0)
    omega = motion.omega(start) if whole_state else start
    tolerances = step_tolerances(rtol, atol, omega)
    steps = budget("max_steps", max_steps)
    if is_full(motion) and not whole_state:
        run, reached = _follow(motion, start, times, tolerances.rtol, steps, options, q0)
        failures = {BRANCH_LOST.format(steps): ~(reached >= times[-1])}
    else:
        y0 = start if whole_state else motion.lift(start)
        try:
            run, result = _solve(motion, y0, times, tolerances, steps, options, q0)
        except TypeError as error:
            if "forward-mode" not in str(error):
                raise
            must = "be `diffrax.ForwardMode()` for derivatives by `jax.jvp` or `jax.jacfwd`"
            raise ValueError(refusal("adjoint", must, "is another one")) from None
        out_of_steps = result == diffrax.RESULTS.max_steps_reached
        failed = ~(diffrax.is_okay(result) | out_of_steps)
        failures = {OUT_OF_STEPS.format(steps): out_of_steps, STEP_FAILED: failed}
        if options.get("saveat") is not None:
            run = _without_unused(run)
    return _raised(run, failures) if options.get("throw", True) else run


class _PlainFunction(OfOmega):
    """A function as an equation dω/dτ = f(τ, ω, args) without a body and without a verdict."""

    function: Callable[..., Any] = eqx.field(static=True)

    def __call__(self, t: Any, y: Vector, args: Any = None) -> Vector:
        """Return the function's value."""
        return self.function(t, y, args)

    @property
    def level(self) -> str:
        """The name of the function."""
        return getattr(self.function, "__name__", type(self.function).__name__)


def _without_unused(run: Trajectory) -> Trajectory:
    """Cut off the unused places of a trajectory, unless it is traced."""
    if not concrete(run.ts):
        return run
    used = np.isfinite(run.ts)
    parts = {name: getattr(run, name) for name in ("ts", "ys", "emitted", "work", "_attitude")}
    return replace(run, **{name: x if x is None else x[used] for name, x in parts.items()})


def _raised(run: Trajectory, failures: dict[str, Any]) -> Trajectory:
    """Return the trajectory, or raise if it failed; a traced one raises when it is computed."""
    for sentence, failed in failures.items():
        if not concrete(failed):
            run = eqx.tree_at(lambda run: run.ys, run, eqx.error_if(run.ys, failed, sentence))
        elif failed:
            raise RuntimeError(sentence)
    return run


def _times(ts: ArrayLike) -> Float[Array, "T"]:
    times = finite("ts", ts, (-1,), batch=False)
    if times.shape[0] < 2:
        refuse("ts", "hold at least two times, the start first", f"has shape {times.shape}")
    known = on_host(times)
    return where_valid("ts", times, (known[1:] > known[:-1]).all(), "increase")


def _follow(
    equation: Equation,
    omega0: Vector,
    times: Float[Array, "T"],
    rtol: Float[Array, ""],
    max_windows: int,
    options: Options,
    q0: Float[Array, "4"] | None,
) -> tuple[Trajectory, Float[Array, ""]]:
    """Return the motion along the physical branch of a full equation, and its last known time."""
    check_branch_options(options)
    turns = q0 is not None
    motion = _differentiable_motion(equation, omega0, times, rtol, max_windows, turns)
    # Adding (τ − τ without derivative)·dy/dτ, which is 0, gives the states their derivatives with
    # respect to the distances of the times from the first one.
    elapsed = times - times[0]
    elapsed = elapsed - jax.lax.stop_gradient(elapsed)
    states = motion.states + jax.vmap(equation)(times, motion.states) * elapsed[:, None]
    energies = motion.energies.T if options.get("balance", False) else ()
    solution = BranchSolution({"num_steps": motion.windows}, motion.reached)
    attitude = motion.attitude
    if q0 is not None and attitude is not None:
        omegas = jax.vmap(equation.omega)(motion.states)
        rates = jax.vmap(quaternion_rate)(attitude, omegas)
        attitude = _from_start(q0, attitude + rates * elapsed[:, None])
    emitted, work = (*energies, None, None)[:2]
    run = Trajectory(equation, times, states, emitted, solution, work, attitude)
    return run, motion.reached


def _from_start(q0: Float[Array, "4"], attitude: Float[Array, "T 4"]) -> Float[Array, "T 4"]:
    """Return the attitudes of a motion from q₀, given the attitudes relative to its start."""
    return jax.vmap(lambda q: product(q0, q))(attitude)


def _differentiable_motion(
    equation: Any,
    omega0: Vector,
    times: Float[Array, "T"],
    rtol: Float[Array, ""],
    max_windows: int,
    attitude: bool,
) -> march.BranchMotion:
    """Return `march.follow`, differentiable by the equation, ω₀ and the first time in both modes.

    All other times are at fixed distances from the first one.
    """
    arrays, rest = eqx.partition(equation, eqx.is_inexact_array)
    first = times[0] if march.depends_on_time(equation) else None
    variables, unravel = ravel_pytree((arrays, omega0, first))

    def follow(variables: Float[Array, "n"], constants: Any) -> march.BranchMotion:
        arrays, omega0, first = unravel(variables)
        times, rtol = constants
        if first is not None:  # all times move with the first one
            times = times + (first - jax.lax.stop_gradient(first))
        varied = eqx.combine(arrays, rest)
        motion = march.follow(varied, omega0, times, rtol, max_windows, attitude)
        return motion._replace(windows=motion.windows.astype(variables.dtype))

    # `forward_mode` differentiates functions with one vector as a result, so the motion is packed.
    packing = []  # the inverse of the packing, known once the function has run

    def packed(variables: Float[Array, "n"], constants: Any) -> Float[Array, "m"]:
        vector, unpacked = ravel_pytree(follow(variables, constants))
        packing.append(unpacked)
        return vector

    vector = forward_differentiable(packed)(variables, (times, rtol))
    motion = packing[0](vector)
    return motion._replace(windows=motion.windows.astype(int))


def _sizes_with_energy(equation: Equation, y: State) -> State:
    """Return the scale of the errors of a state, which may be followed by energy integrals.

    The scale of the integrals is the largest component of ω squared, or their own size if larger.
    """
    n = state_of(equation).shape[0]
    least = jnp.max(jnp.abs(equation.omega(y[:n]))) ** 2
    return jnp.concatenate([error_scale_of(equation)(y[:n]), jnp.maximum(jnp.abs(y[n:]), least)])


def _sizes_with_turn(equation: Equation, y: State) -> State:
    """Return the scale of the errors of a state with energy integrals, if any, and a turn behind.

    An error of the turn is an angle, with the scale of 1 radian.
    """
    return jnp.concatenate([_sizes_with_energy(equation, y[:-5]), jnp.ones_like(y[-5:])])


def _field(equation: Any, n: int, balance: bool, turns: bool) -> Any:
    """Return the rates of n numbers of the state, and of energy integrals and turn, if wanted."""

    def field(t: Any, y: State, args: Any) -> State:
        rates = [equation(t, y[:n], args)]
        if balance:
            rates.append(energy_flows(equation, t, y[:n]))
        if turns:
            rates.append(turn_rate(y[-5:], twist_axis(equation), equation.omega(y[:n])))
        return jnp.concatenate(rates)

    return field


def _up_to_event(
    times: Float[Array, "T"], solution: Any
) -> tuple[Float[Array, "T"], Float[Array, "T m"]]:
    """Return times and states, with the values of an event after it; inf where a run failed.

    diffrax saves the end of the run after the last of `times` that it reached.
    """
    end = jnp.sum(jnp.isfinite(solution.ts)) - 1
    behind, is_event = jnp.arange(times.size) >= end, diffrax.is_event(solution.result)
    last = jnp.where(is_event, solution.ys[end], jnp.inf)
    ys = jnp.where(behind[:, None], last, solution.ys[:-1])
    return jnp.where(behind & is_event, solution.ts[end], times), ys


@compiled_soon
def _solve(
    equation: Any,
    y0: State,
    times: Float[Array, "T"],
    tolerances: Tolerances,
    max_steps: int,
    options: Any,
    q0: Float[Array, "4"] | None,
) -> tuple[Trajectory, Any]:
    """Return the motion by diffrax, and diffrax's result."""
    n = y0.shape[0]
    balance, turns = options.get("balance", False), q0 is not None
    flows = 0
    if balance:
        flows = jax.eval_shape(functools.partial(energy_flows, equation), times[0], y0).shape[0]
    sizes = _sizes_with_turn if turns else _sizes_with_energy
    controller = options.get("stepsize_controller")
    if controller is None:
        controller = Controller(*tolerances, Partial(sizes, equation))
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(_field(equation, n, balance, turns)),
        options.get("solver") or diffrax.Dopri8(),
        times[0],
        times[-1],
        options.get("dt0"),
        jnp.concatenate([y0, jnp.zeros(flows), *([no_turn(y0)] if turns else [])]),
        saveat=saved_at(options, times),
        stepsize_controller=ending_at_jumps(controller, equation),
        adjoint=options.get("adjoint") or diffrax.RecursiveCheckpointAdjoint(),
        event=event_of(options, n),
        progress_meter=options.get("progress_meter") or diffrax.NoProgressMeter(),
        max_steps=max_steps,
        throw=False,
    )
    ys: Any = solution.ys
    if options.get("saveat") is not None:
        times = jnp.asarray(solution.ts)
    elif options.get("event") is not None:
        times, ys = _up_to_event(times, solution)
    # States that were not reached shall have derivatives NaN, but diffrax's inf has derivatives 0.
    # NaN multiplies a number that depends on all inputs, since `where` would put NaN into the
    # reverse-mode derivatives of complete runs.
    everything = jnp.sum(y0) + jnp.sum(equation(times[0], y0, None))
    ys = ys + jnp.where(jnp.isfinite(ys), 0.0, jnp.nan) * everything
    states, (emitted, work) = ys[:, :n], (*ys[:, n : n + flows].T, None, None)[:2]
    attitude, axis = None, twist_axis(equation)
    if q0 is not None:
        attitude = _from_start(q0, jax.vmap(lambda y: attitude_after(y[-5:], axis))(ys))
    run = Trajectory(equation, times, states, emitted, solution, work, attitude)
    return run, solution.result
