"""One adaptive step of an explicit Runge–Kutta method, for a block of lanes.

`begin` and `advance` are pure functions of the state of a block. The JAX engine calls them in a
loop; the native engine traces them for one lane and compiles them to machine code. The equation
is any first-order equation whose components lie on axis 0; the method is any explicit diffrax
solver, by its Butcher tableau.
"""

import functools
from collections.abc import Callable
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._base.guards import beside
from .._base.stopping import (
    BROKEN,
    EXHAUSTED,
    FINISHED,
    RUNNING,
    Until,
    decided,
    prepared_verdicts,
    sound,
)
from .._base.tolerances import Tolerances
from .._base.types import Equation, Real, State
from ..equations._common import error_scale_of, jumps_of
from .interface import Limits
from .step_sizes import error_ratio, first_step, root

SAFETY, SHRINK, GROW = 0.9, 0.2, 10.0  # factors of the step size, as in diffrax
LARGE, WIDE = 290, 10  # operations and components of a rate above which the stages form a loop


class LaneState(eqx.Module):
    """The state of runs, lanes on the trailing axis of everything."""

    y: Float[Array, "n B"]
    f: Float[Array, "n B"]
    """The rate at (t, y)."""
    t: Float[Array, "B"]
    compensation: Float[Array, "B"]
    """Kahan's compensation: the rounding error of t so far, so that long runs keep time."""
    h: Float[Array, "B"]
    """Size of the next step."""
    steps: Int[Array, "B"]
    status: Int[Array, "B"]
    """RUNNING, FINISHED, EXHAUSTED or BROKEN, see `stopping`."""
    equation: Any
    atol: Float[Array, "B"]
    t1: Float[Array, "B"]
    prepared: Any
    """The numbers that the equation has prepared for its verdicts, or None."""


def begin(equation: Equation, y0: State, limits: Limits, order: int, until: Until) -> LaneState:
    """Return the runs at τ = 0 with rates and step sizes; some are finished or broken at once."""
    tolerances = limits.tolerances
    f = _first_rate(equation, jnp.zeros_like(limits.t1), y0)
    h = first_step(equation, error_scale_of(equation), y0, f, tolerances, order)
    able = sound(0 * h, y0, f) & jnp.isfinite(h)
    prepared = prepared_verdicts(equation)
    done = decided(equation, y0, tolerances, until, prepared) | (limits.t1 <= 0)
    status = jnp.where(limits.max_steps > 0, RUNNING, EXHAUSTED)
    status = jnp.where(able, jnp.where(done, FINISHED, status), BROKEN).astype("int32")
    zero = jnp.zeros_like(h)
    none = zero.astype("int32")
    atol, t1 = jnp.asarray(limits.atol), jnp.asarray(limits.t1)
    return LaneState(y0, f, zero, zero, h, none, status, equation, atol, t1, prepared)


def _first_rate(equation: Equation, t: Real, y0: State) -> State:
    """Return the rates at τ = 0; explain the error of an equation that takes one state only."""
    try:
        return equation(t, y0, None)
    except (TypeError, ValueError) as error:
        error.add_note(
            f"{type(equation).__name__} was called with many states at once, of shape "
            f"({y0.shape[0]}, lanes); the axis of lanes is the last one of its arrays, too. "
            "`matrix @ y` fits one state only: write such sums in components."
        )
        raise


def advance(
    state: LaneState, rtol: Real, max_steps: Array, solver: diffrax.AbstractERK, until: Until
) -> LaneState:
    """Try one step in every lane that is running."""
    tolerances = Tolerances(rtol, state.atol)
    running = state.status == RUNNING
    state, goal = _before_jump(state)
    left = goal - state.t - state.compensation
    arrives = state.h >= left
    last = arrives & (goal == state.t1)
    h = jnp.where(arrives, left, state.h)
    new, rate, error = runge_kutta_step(solver, state.equation, state, h, goal)
    ratio = error_ratio(error_scale_of(state.equation), error, (state.y, new), tolerances)
    factor = SAFETY / root(jnp.maximum(ratio, 1e-30), int(solver.order(None) or 0))
    regular = jnp.isfinite(ratio)  # if a stage overflows, a smaller step is tried
    accept = running & regular & (ratio <= 1)
    factor = jnp.where(regular, jnp.clip(factor, SHRINK, jnp.where(accept, GROW, 1.0)), SHRINK)

    y = jnp.where(accept[None], new, state.y)
    f = jnp.where(accept[None], rate, state.f)
    steps = state.steps + running.astype(state.steps.dtype)
    # Step-size underflow: the rejected step is already below the rounding error of y.
    rounding = 4 * jnp.finfo(h.dtype).eps * jnp.abs(state.y)
    stuck = jnp.all(jnp.abs(h[None] * state.f) <= rounding, axis=0)
    gain = h + state.compensation
    later = jnp.where(arrives, goal, state.t + gain)
    t = jnp.where(accept, later, state.t)
    compensation = jnp.where(accept, gain - (later - state.t), state.compensation)
    # Evaluated at the proposed state unconditionally: that shortens the chain of dependent
    # operations in machine code.
    broken = jnp.where(accept, ~sound(later, new, rate), stuck)
    done = accept & (last | decided(state.equation, new, tolerances, until, state.prepared))
    status = jnp.where(steps < max_steps.astype(steps.dtype), RUNNING, EXHAUSTED)
    status = jnp.where(broken, BROKEN, jnp.where(done, FINISHED, status))
    status = jnp.where(running, status, state.status).astype(state.status.dtype)
    h = jnp.where(running, h * factor, state.h)
    kept = state.equation, state.atol, state.t1, state.prepared
    return LaneState(y, f, t, compensation, h, steps, status, *kept)


def _before_jump(state: LaneState) -> tuple[LaneState, Float[Array, "B"]]:
    """Return the state with the rate behind a jump of a torque at t, and where a step must end."""
    jumps = jumps_of(state.equation)
    if jumps is None:
        return state, state.t1
    later = beside(state.t, 1)
    goal = state.t1
    for jump in jumps:
        goal = jnp.where(jump > later, jnp.minimum(goal, jump), goal)
    rate = state.equation(later, state.y, None)
    return eqx.tree_at(lambda s: s.f, state, rate), goal


def runge_kutta_step(
    solver: diffrax.AbstractERK, equation: Equation, state: LaneState, h: Real, goal: Real
) -> tuple[State, State, State]:
    """Return one step of the tableau: the new state, its rate, and the error.

    No rate is evaluated at or behind `goal`, where a torque may jump.
    """
    tableau: Any = solver.tableau

    def time(part: Any) -> Real:
        then = state.t + part * h
        return then if jumps_of(equation) is None else jnp.minimum(then, beside(goal, -1))

    if len(state.y) > WIDE or _operations(equation, state.y) > LARGE:
        rates = _rates_by_loop(tableau, equation, state, h, time)
    else:
        rates = [state.f]
        for c, row in zip(tableau.c, tableau.a_lower, strict=True):
            stage = state.y + h[None] * _weighted_sum(row, rates)
            rates.append(equation(time(float(c)), stage, None))
    error = h[None] * _weighted_sum(tableau.b_error, rates)
    new = state.y + h[None] * _weighted_sum(tableau.b_sol, rates)
    if tableau.fsal:  # the last stage is the new state
        return new, rates[-1], error
    return new, equation(time(1.0), new, None), error


def _weighted_sum(weights: np.ndarray, rates: list[State]) -> State:
    """Return Σ wᵢ kᵢ without the terms of zero weight."""
    terms = [float(w) * k for w, k in zip(weights, rates, strict=True) if w != 0]
    return functools.reduce(jnp.add, terms)


def _operations(equation: Equation, y: State) -> int:
    """Return the number of operations of the right-hand side."""
    like = jax.ShapeDtypeStruct(y.shape, y.dtype), jax.ShapeDtypeStruct(y.shape[1:], y.dtype)
    return len(jax.make_jaxpr(lambda y, t: equation(t, y, None))(*like).eqns)


def _rates_by_loop(
    tableau: Any, equation: Equation, state: LaneState, h: Real, time: Callable[[Any], Real]
) -> list[State]:
    """Return the rates of all stages by a loop, which compiles a long right-hand side only once."""
    size = len(tableau.c) + 1
    rows = np.zeros((size, size))
    for i, row in enumerate(tableau.a_lower, 1):
        rows[i, :i] = row
    weights = jnp.asarray(rows, state.y.dtype)
    times = jnp.asarray(np.append(0.0, tableau.c), state.y.dtype)

    def stage(i: Any, rates: Array) -> Array:
        shift = jnp.einsum("s,snb->nb", weights[i], rates, precision="highest")
        rate = equation(time(times[i]), state.y + h[None] * shift, None)
        return rates.at[i].set(rate)

    rates = jnp.zeros((size, *state.y.shape), state.y.dtype).at[0].set(state.f)
    return list(jax.lax.fori_loop(1, size, stage, rates))
