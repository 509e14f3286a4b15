"""The outcome of one run: by an engine if the start is known, else within the trace."""

from typing import Any, NoReturn

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from .._base.checks import (
    ArrayLike,
    NumberLike,
    check_single,
    check_verdict,
    checked_start,
    concrete,
    is_whole_state,
    known_start,
)
from .._base.compiling import compiled_soon
from .._base.parallel import worker_devices
from .._base.refusals import refuse
from .._base.stopping import RUNNING, Until
from .._base.tolerances import MAX_STEPS, Tolerances, budget, step_tolerances
from .._base.types import DecidingEquation, Equation, State
from .._engines.branch_engine import end_on_branch
from .._engines.interface import EndStates, Limits
from .._engines.step import advance, begin
from ..equations._common import error_scale_of, is_full, omega_scale_of, physical
from .blocks import Place, classify_block
from .classification import Classification, Value, classification_of, stopping_rule
from .classify_many import Runs
from .conditioning import run_with_error_estimate, without_error_estimates
from .label_doubt import exact_when_slow
from .run_settings import RunSettings
from .slow_runs import SlowFlow, check_slow_flow


def classify(
    equation: Equation,
    omega0: ArrayLike,
    *,
    rtol: NumberLike = 1e-8,
    atol: NumberLike | None = None,
    max_steps: int | np.integer = MAX_STEPS,
    value: Value = True,
    slow_flow: SlowFlow = "auto",
) -> Classification:
    """Classify how dω/dτ = equation(ω) ends from one ω₀ (`classify_many`: from many, far faster).

    Integrates (order 8) until the equation's own `verdict` is certain. A full equation is
    followed along its physical branch, whose windows count as steps. May be jitted and vmapped,
    with the same numbers as by `classify_many`, which takes known values only. Not differentiable:
    `residual_rotation` gives ω∞ with its derivatives.

    | `value` | the run ends when | `omega_inf_error` | cost |
    |---|---|---|---|
    | True | outcome and ω∞ are known | estimated, if need be from neighbouring starts | 1 |
    | "unchecked" | outcome and ω∞ are known | infinite if ω∞ was integrated | about ½ |
    | False | the outcome is known | as "unchecked"; ω∞ is NaN where it was integrated | less |

    The slower a top radiates, the more steps its run takes. Where their estimated number exceeds
    the budget, averages over free rotation predict what the first state does not decide, as in
    `predict`, at once and at any amplitude. A prediction is never certified; where chance decides,
    as for needles, it is a `probability` and the outcome is UNDECIDED.

    | `slow_flow` | predicted runs |
    |---|---|
    | "auto" | runs whose estimated number of steps exceeds `max_steps`, and those that exhaust it |
    | True | all runs that the first state does not decide |
    | False | none |

    Only the rigid bodies of this library are predicted, in float64; at order 1 not the bodies that
    are captured by chance, since order 1 omits a leading term there. Under `jit`, `vmap` or `grad`
    "auto" predicts nothing.

    Args:
        equation: an equation with a `verdict`.
        omega0: start ω₀, shape (3,), dimensionless, body axes.
        rtol: relative tolerance of every step; for the error of ω∞ see `omega_inf_error`.
        atol: absolute tolerance of every step; None means 0, since errors are measured by the
            present |ω|; or, with `value=False`, rtol·|ω₀| if all slow motions of this top have
            the same outcome.
        max_steps: largest number of steps; a run that needs more is predicted, or UNDECIDED.
        value: whether ω∞ is wanted, and the estimate of its error; see the table.
        slow_flow: whether runs are predicted; see the table.

    Returns:
        A `Classification` with scalar fields.

    Raises:
        ValueError: bad arguments; a derivative is wanted. A run that fails is an outcome, FAILED.

    Example:
        >>> import dipoletop as dt
        >>> verdict = dt.classify(dt.TransverseReduced(-0.2), dt.cylindrical(0.2, 0.2, 0.1047))
        >>> dt.Outcome(int(verdict.outcome)).name, bool(verdict.certified)
        ('RESIDUAL', True)
        >>> body = dt.Body([[1.0, 0, 0], [0, 1.3, 0], [0, 0, 1.8]], [0, 0, 1])
        >>> slow = dt.classify(dt.SemiReduced(body), [1e-20, 2e-20, 3e-20])
        >>> dt.Outcome(int(slow.outcome)).name, dt.Regime(int(slow.regime)).name
        ('RESIDUAL', 'SLOW_FLOW')
    """
    whole_state = is_whole_state(omega0)
    known = concrete(equation, omega0, rtol, atol)
    why_not = "" if known else "the start is traced"
    check_slow_flow(slow_flow, equation, why_not or ("the start is a whole state" * whole_state))
    if known and not whole_state:
        settings = RunSettings(rtol, atol, max_steps, value, "auto", slow_flow)
        return _classify_by_engine(equation, omega0, settings)
    arrays, rest = eqx.partition((equation, omega0), eqx.is_inexact_array)
    constant = eqx.combine(_without_derivative(arrays), rest)
    return classify_with_tangents(*constant, rtol=rtol, atol=atol, max_steps=max_steps, value=value)


def _classify_by_engine(equation: Any, omega0: Any, settings: RunSettings) -> Classification:
    """Return the classification of one known start, as a block of one lane."""
    settings = settings.checked(equation)
    check_single(equation)
    one = Runs(equation, True, known_start(omega0)[None], settings).tile(0, 1)
    device = worker_devices()[0]
    engine = settings.engines(one[0], [device], warn=False)[device]
    run = classify_block(*one, settings, Place(engine, device))
    return jax.tree.map(lambda x: jnp.asarray(x[..., 0]), run)


@jax.custom_jvp
def _without_derivative(arrays: Any) -> Any:
    """Return arrays that refuse to be differentiated."""
    return arrays


@_without_derivative.defjvp
def _(_primals: Any, _tangents: Any) -> NoReturn:
    constants = "`jax.lax.stop_gradient` makes a constant of it"
    must = f"not be differentiated here (`residual_rotation` differentiates ω∞; {constants})"
    refuse("omega0", must, "it or the equation is")


def classify_with_tangents(
    equation: Any,  # checked here, as is the start
    omega0: Any,
    *,
    rtol: NumberLike,
    atol: NumberLike | None,
    max_steps: int | np.integer,
    value: Value = True,
) -> Classification:
    """Classify one start within a trace, with the derivatives of the state that ended the run.

    Nothing is predicted.
    """
    check_verdict(equation)
    check_single(equation)
    from_omega = not is_whole_state(omega0)
    if from_omega:
        equation = physical(equation)
    start = checked_start(equation, omega0)
    omega = start if from_omega else equation.omega(start)
    until = stopping_rule(equation, value)
    exact = exact_when_slow(equation, value)
    tolerances = step_tolerances(rtol, atol, omega, exact)
    steps = budget("max_steps", max_steps)
    if is_full(equation) and not from_omega:
        until = "time"  # off the branch no verdict holds, and the top runs away
    return _classify(equation, (start, from_omega), tolerances, steps, until, value)


@compiled_soon
def _classify(
    equation: DecidingEquation,
    begin: tuple[Array, bool],
    tolerances: Tolerances,
    max_steps: int,
    until: Until,
    value: Value,
) -> Classification:
    """Return the classification of a run that begins at ω₀ (True), or at a whole state."""
    start, from_omega = begin

    def run(start: Array, tolerances: Tolerances, wanted: Bool[Array, ""]) -> Classification:
        y0 = equation.lift(start) if from_omega else start
        t1 = jnp.where(wanted, jnp.inf, 0.0)
        limits = Limits(*tolerances, t1, jnp.asarray(max_steps))
        if from_omega and is_full(equation):
            ends = end_on_branch(equation, y0, limits, until)
        else:
            ends = _end_by_steps(equation, y0, limits, until)
        return classification_of(equation, ends, tolerances)

    if value is True and until != "time":
        sizes = omega_scale_of(equation) if from_omega else error_scale_of(equation)
        return run_with_error_estimate(run, start, sizes(start), tolerances)
    return without_error_estimates(run(start, tolerances, jnp.asarray(True)), value, jnp)


def _end_by_steps(equation: DecidingEquation, y0: State, limits: Limits, until: Until) -> EndStates:
    """Return the end state of a run, by the steps of the engines in a block of one lane."""
    arrays, rest = eqx.partition((equation, y0, limits.atol, limits.t1), eqx.is_array)
    lane, y, atol, t1 = eqx.combine(jax.tree.map(lambda x: x[..., None], arrays), rest)
    limits = limits._replace(atol=atol, t1=t1)
    solver = diffrax.Dopri8()
    begun = begin(lane, y, limits, solver.order(None), until)
    moving, rest = eqx.partition(begun, eqx.is_array)

    def step(moving: Any) -> Any:
        state = eqx.combine(moving, rest)
        state = advance(state, limits.rtol, limits.max_steps, solver, until)
        return eqx.filter(state, eqx.is_array)

    last = jax.lax.while_loop(lambda moving: moving.status[0] == RUNNING, step, moving)
    ended = EndStates(last.y[:, 0], last.t[0], last.steps[0], last.status[0])
    # Off the branch no verdict holds.
    return ended._replace(y=ended.y * jnp.nan) if until == "time" else ended
