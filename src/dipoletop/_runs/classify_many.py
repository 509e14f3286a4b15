"""How a run ends: one start through diffrax, many through the lane engine."""

from typing import Any, Literal, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._base import stopping as _endings
from .._base.checks import (
    check_single,
    check_verdict,
    concrete,
    initial_state,
    is_single,
    is_whole_state,
    real,
    refuse,
    subnormal,
)
from .._base.parallel import Device, in_parallel, worker_devices
from .._base.tolerances import MAX_STEPS, Tolerances, absolute, budget, tolerance
from .._base.types import Equation, Outcome, Stop, Verdict
from .._branch import march as manifold
from .._engines.branch_engine import end_on_branch
from .._engines.interface import EndStates, Engine, Limits
from .._engines.select import select_engines
from .._engines.step_sizes import Controller
from ..equations._common import scales_of, sizes_of
from ..equations.tangent import Tangent
from .conditioning import checked, checked_alone, series_error, unchecked

TILE = 16384  # starts handed to the engine at once, at most
UNCHECKED = "unchecked"
Value = bool | Literal["unchecked"]
"""Whether ω∞ is wanted: with an estimate of its error (True), without (UNCHECKED), or not."""


class Classification(eqx.Module):
    """How runs end; every field has the shape of the batch, () for a single start.

    The computed basin boundary is itself uncertain by about `rtol`: a start closer to it than
    that can carry either label, certified or not.
    """

    outcome: Int[Array, "*n"] | Int[np.ndarray, "*n"]
    """A member of `Outcome`: RESIDUAL, STOP, UNDECIDED (out of steps) or FAILED."""
    omega_inf: Float[Array, "*n"] | Float[np.ndarray, "*n"]
    """Residual angular velocity along the dipole, signed; 0 for STOP; NaN if undecided, if the run
    ended (for want of steps, or with `value=False`) before it was known, or if
    `omega_inf_error` exceeds it."""
    omega_inf_error: Float[Array, "*n"] | Float[np.ndarray, "*n"]
    """Estimated absolute error of `omega_inf`: 0 for STOP, and where ω₁ is constant; infinite where
    there is no estimate."""
    time: Float[Array, "*n"] | Float[np.ndarray, "*n"]
    """τ at which the run ended, in units of τ₀."""
    steps: Int[Array, "*n"] | Int[np.ndarray, "*n"]
    """Integration steps tried."""
    certified: Bool[Array, "*n"] | Bool[np.ndarray, "*n"]
    """Whether the state that ended the run lies in a region proven to decide, for this level of
    the equation: what another level says is not proven by it."""
    stop: Int[Array, "*n"] | Int[np.ndarray, "*n"]
    """A member of `Stop`: in which way a top stops."""
    slopes: Float[Array, "m *n"] | Float[np.ndarray, "m *n"] | None = None
    """The variations of ω∞ along the m ones of a `Tangent` equation: 0 where the top stops as its
    neighbours do; infinite along a change that turns the dipole of a general body off its
    principal axis, or leaves what alone keeps ω₁ constant; NaN where ω∞ is not known, or has no
    derivatives. Else None."""


def assemble(equation: Equation, ends: EndStates, scale: Tolerances) -> Classification:
    """The final verdict on end states; a state that is not a number decides nothing."""
    y, status = jnp.asarray(ends.y), ends.status
    verdict = Verdict(*equation.verdict(y))  # pyright: ignore[reportAttributeAccessIssue]
    broken = status == _endings.BROKEN
    known = ~broken & (verdict.outcome != Outcome.UNDECIDED)
    missing = jnp.where(broken, Outcome.FAILED, Outcome.UNDECIDED)
    settled = known & _endings.settled(verdict, scale, 1.0)
    slopes = None
    if isinstance(equation, Tangent):
        sure = settled & _endings.slopes_settled(verdict, scale[0])
        sure = sure & ~((verdict.outcome == Outcome.STOP) & equation.astray(y, scale[0]))
        slopes = jnp.where(sure[None], equation.slopes(y), jnp.nan)
    return Classification(
        jnp.where(known, verdict.outcome, missing).astype(int),
        jnp.where(settled, verdict.omega_inf, jnp.nan),
        jnp.where(settled, series_error(equation, verdict), jnp.nan),
        ends.t,
        jnp.asarray(ends.steps, int),
        known & verdict.certified_for(equation),
        jnp.where(known, verdict.stop, Stop.NONE).astype(int),
        slopes,
    )


def goal(equation: Any, value: Value) -> _endings.Until:
    """What must be certain before a run ends."""
    if not (isinstance(value, bool) or (isinstance(value, str) and value == UNCHECKED)):
        refuse("value", f"be True, False or {UNCHECKED!r}", f"is {value!r}")
    if not value:
        return "outcome"
    return "slope" if isinstance(equation, Tangent) else "value"


def classify(
    equation: Equation,
    omega0: Any,
    *,
    rtol: Any = 1e-8,
    atol: Any = None,
    max_steps: Any = MAX_STEPS,
    value: Value = True,
) -> Classification:
    """How dω/dτ = equation(ω) ends from ω(0) = ω₀: residual rotation, stop, or undecided.

    Integrates with diffrax (order 8) until the equation's own `verdict` is certain; a full
    equation is followed along its physical branch, whose windows count as steps. May be jitted
    and vmapped; for many starts `classify_many` is far faster. Its derivatives are NaN: those of
    ω∞ are had from `residual_rotation`, and a label, or the time of the last step, has none.

    Args:
        equation: an equation with a `verdict`.
        omega0: start ω₀, shape (3,), dimensionless, body axes.
        rtol: relative tolerance of every step; `omega_inf_error` tells how exact ω∞ is.
        atol: absolute tolerance; None means none, since errors are measured by the present |ω|; or
            rtol·|ω₀| with `value=False`.
        max_steps: budget; a run that exhausts it is UNDECIDED.
        value: whether to go on until ω∞ is known, not only its outcome: True, with an estimate of
            its error from three neighbouring starts; "unchecked", without, for about a third of
            the cost; or False.

    Returns:
        A `Classification` with scalar fields.

    Raises:
        ValueError: bad arguments. A run that fails is an outcome, FAILED.

    Example:
        >>> import dipoletop as dt
        >>> verdict = dt.classify(dt.TransverseReduced(-0.2), dt.cylindrical(0.2, 0.2, 0.1047))
        >>> dt.Outcome(int(verdict.outcome)).name, bool(verdict.certified)
        ('RESIDUAL', True)
    """
    arrays, rest = eqx.partition((equation, omega0), eqx.is_inexact_array)
    still = eqx.combine(jax.lax.stop_gradient(arrays), rest)
    found = classified(*still, rtol=rtol, atol=atol, max_steps=max_steps, value=value)
    none = _no_derivative(jax.tree.leaves(arrays))
    return jax.tree.map(lambda x: x + none if eqx.is_inexact_array(x) else x, found)


@jax.custom_jvp
def _no_derivative(_: Any) -> float:
    """0, whose derivatives are NaN."""
    return 0.0


@_no_derivative.defjvp
def _(primals: Any, tangents: Any) -> tuple[float, Any]:
    return 0.0, jnp.nan * sum(jnp.sum(change) for change in tangents[0])


def classified(
    equation: Any, omega0: Any, *, rtol: Any, atol: Any, max_steps: Any, value: Value = True
) -> Classification:
    """What `classify` finds, with the derivatives of the state that ended the run."""
    check_verdict(equation)
    check_single(equation)
    from_omega = not is_whole_state(omega0)
    if from_omega:
        equation = manifold.physical(equation)
    y0 = initial_state(equation, omega0)
    rtol = tolerance("rtol", rtol)
    until = goal(equation, value)
    least = absolute(atol, rtol, equation.omega(y0), label_only=until == "outcome")
    scale = Tolerances(rtol, least)
    steps = budget("max_steps", max_steps)
    start = real("omega0", omega0, (3,), batch=False) if from_omega else y0
    end = _end_by_steps
    if manifold.is_full(equation):
        # Off the branch no region decides: nothing but the runaway.
        end, until = (_end_on_branch, until) if from_omega else (end, "time")
    return _classify(equation, start, scale, (end, from_omega, steps, until, value))


@eqx.filter_jit
def _classify(equation: Any, start: Array, scale: Any, how: Any) -> Classification:
    end, from_omega, max_steps, until, value = how

    def run(start: Array, scale: Any, wanted: Array) -> Classification:
        y0 = equation.lift(start) if from_omega else start
        ends = end(equation, y0, scale, jnp.where(wanted, jnp.inf, 0.0), max_steps, until)
        return assemble(equation, ends, scale)

    if value is True and until != "time":
        measure = scales_of(equation) if from_omega else sizes_of(equation)
        return checked_alone(run, start, measure(start), scale)
    return unchecked(run(start, scale, jnp.asarray(True)), value, jnp)


def _end_on_branch(equation, y0, scale, t1, max_steps: int, until: _endings.Until) -> EndStates:
    limits = Limits(scale.rtol, scale.atol, t1, jnp.asarray(max_steps))
    return end_on_branch(equation, y0, limits, until)


def _end_by_steps(equation, y0, scale, t1, max_steps: int, until: _endings.Until) -> EndStates:
    rtol, atol = scale

    def ended(t, y, args, **_):
        broken = ~_endings.sound(t, y, equation(t, y, None))
        return broken | _endings.decided(equation, y, scale, until)

    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(equation),
        diffrax.Dopri8(),
        0.0,
        # Decided or broken at once: no time to integrate.
        jnp.where(ended(jnp.zeros(()), y0, None), 0.0, t1),
        None,
        y0,
        stepsize_controller=Controller(rtol, atol, sizes_of(equation)),
        saveat=diffrax.SaveAt(t1=True),
        event=diffrax.Event(ended),
        max_steps=max_steps,
        adjoint=diffrax.ForwardMode(),
        throw=False,
    )
    y = solution.ys[-1]  # pyright: ignore[reportOptionalSubscript]
    time = solution.ts[-1]  # pyright: ignore[reportOptionalSubscript]
    able = _endings.sound(time, y, equation(time, y, None))
    if until == "time":
        y = y * jnp.nan  # which decides nothing
    status = jnp.where(able, _endings.FINISHED, _endings.BROKEN)
    return EndStates(y, time, solution.stats["num_steps"], status)


def classify_block(
    equation: Equation,
    omegas: Float[Array, "3 N"] | Float[np.ndarray, "3 N"],
    limits: Limits,
    value: Value,
    engine: Engine,
    device: Device,
    threads: int = 1,
) -> Classification:
    """Classify a block: fields of `equation` carry a trailing axis N; runs on one device."""
    if device.platform == "cpu" and np.any(lost := subnormal(omegas)):
        omegas = np.where(lost, np.nan, omegas)
    how = {"until": goal(equation, value), "device": device, "threads": threads}
    equation = manifold.physical(equation)

    def run(omegas: Any, limits: Limits) -> Classification:
        found = engine.classify(assemble, equation, omegas, limits, **how)
        return jax.tree.map(np.asarray, found)

    found = run(omegas, limits)
    if value is True:
        return checked(found, run, omegas, limits, scales_of(equation))
    return unchecked(found, value, np)


def classify_many(
    equations: Equation,
    omegas: Any,
    *,
    rtol: Any = 1e-8,
    atol: Any = None,
    max_steps: Any = MAX_STEPS,
    value: Value = True,
    engine: str = "auto",
) -> Classification:
    """How N runs end, by the lane engine, on all cores or devices.

    Args:
        equations: an equation with a `verdict`: one for all starts, or with a leading batch axis
            of N on every array field, as `TransverseReduced(delta=deltas)` has.
        omegas: starts ω₀, shape (N, 3), dimensionless, body axes. A start that is not finite, or
            has a subnormal component (which processors take for 0), is FAILED, and harms no other.
        rtol: relative tolerance of every step; `omega_inf_error` tells how exact ω∞ is.
        atol: absolute tolerance, a number or shape (N,); None means none, since errors are measured
            by the present |ω|; or rtol·|ω₀| for each start with `value=False`.
        max_steps: budget of each run; one that exhausts it is UNDECIDED.
        value: whether to go on until ω∞ is known, not only its outcome: True, with an estimate of
            its error from three neighbouring starts; "unchecked", without, for about a third of
            the cost; or False.
        engine: "jax", "native" (machine code, for float64 on processors; it needs numba), or
            "auto", the fastest that can run here.

    Returns:
        A `Classification` whose fields are NumPy arrays of shape (N,).

    Raises:
        ValueError: bad arguments.

    Example:
        >>> import jax.numpy as jnp, dipoletop as dt
        >>> starts = jnp.array([[0.2, 0.0, 0.0], [0.0, 0.2, 0.0]])
        >>> dt.classify_many(dt.TransverseReduced(jnp.array([-0.2, -0.3])), starts).outcome
        array([1, 2])
    """
    check_verdict(equations, "equations")
    if not concrete(equations, omegas):
        refuse("omegas", "be known (`jax.vmap` of `classify` takes what is traced)", "is traced")
    starts = real("omegas", omegas, (-1, 3), batch=False)
    size = starts.shape[0]
    if size == 0:
        refuse("omegas", "hold at least one start", "holds none")
    rtol = tolerance("rtol", rtol)
    scale = absolute(atol, rtol, starts, axis=-1, label_only=value is False)
    steps = jnp.asarray(budget("max_steps", max_steps))
    whole = _Runs(equations, np.asarray(starts), np.asarray(scale), rtol, steps)
    single = is_single(equations)
    if not single:
        _check_batch(equations, size)
    until = goal(equations, value)
    crew = worker_devices()
    block = _cut(whole, 0, size, single)
    engines = select_engines(engine, block[0], crew, until, assemble)
    if engines[crew[0]].has_own_threads:  # which share one queue
        return classify_block(*block, value, engines[crew[0]], crew[0], threads=len(crew))
    tile = min(TILE, power_of_two(-(-size // len(crew))))

    def work(job: int, device: Any) -> Classification:
        part = _cut(whole, job * tile, tile, single)
        return classify_block(*part, value, engines[device], device)

    parts = dict(in_parallel(work, range(-(-size // tile)), crew))
    found = [parts[job] for job in sorted(parts)]
    return jax.tree.map(lambda *x: np.concatenate(x, axis=-1)[..., :size], *found)


class _Runs(NamedTuple):
    """All that is asked of `classify_many`."""

    equations: Any
    starts: Float[np.ndarray, "N 3"]
    atol: Float[np.ndarray, "N"]
    rtol: Float[Array, ""]
    max_steps: Int[Array, ""]


def _cut(runs: _Runs, first: int, tile: int, single: bool) -> tuple[Any, Any, Limits]:
    """One tile: equation with its lanes behind, starts and limits. Padding takes no step.

    In NumPy, by views if the tile is full: JAX would take as long as the machine code to come.
    """
    size, end = len(runs.starts), first + tile
    t1 = np.full(tile, np.inf, runs.starts.dtype)
    t1[max(size - first, 0) :] = 0.0
    at: Any = slice(first, end) if end <= size else np.minimum(np.arange(first, end), size - 1)

    def lanewise(x: Array) -> np.ndarray:
        numbers = np.asarray(x)
        if single:
            return np.broadcast_to(numbers[..., None], (*numbers.shape, tile))
        return np.moveaxis(numbers[at], 0, -1)

    arrays, rest = eqx.partition(runs.equations, eqx.is_array)
    equation = eqx.combine(jax.tree.map(lanewise, arrays), rest)
    limits = Limits(runs.rtol, runs.atol[at], t1, runs.max_steps)
    return equation, runs.starts[at].T, limits


def power_of_two(least: int) -> int:
    """The smallest power of two that is at least `least` and 128, so that few sizes compile."""
    return max(128, 1 << (least - 1).bit_length())


def _check_batch(equations: Any, size: int) -> None:
    for leaf in jax.tree.leaves(eqx.filter(equations, eqx.is_array)):
        if leaf.ndim == 0 or leaf.shape[0] != size:
            refuse(
                "equations",
                f"be a single equation or have {size} entries on the leading axis of every field",
                f"has a field of shape {leaf.shape}",
            )
