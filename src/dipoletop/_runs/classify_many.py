"""The outcomes of many runs, by the engines, on all cores or devices."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._base.checks import (
    ArrayLike,
    NumberLike,
    check_verdict,
    concrete,
    is_single,
    real,
    refuse,
    subnormal,
)
from .._base.parallel import Device, in_parallel, worker_devices
from .._base.tolerances import MAX_STEPS, absolute, budget, tolerance
from .._base.types import DecidingEquation, Equation
from .._engines.interface import Engine, Limits, Queue
from .._engines.select import select_engines
from ..equations._common import omega_scale_of, physical
from .classification import Classification, Value, classification_of, stopping_rule
from .conditioning import with_error_estimates, without_error_estimates
from .slow_runs import (
    SlowFlow,
    check_slow_flow,
    slow_motions,
    with_predictions,
    with_probability,
)

TILE = 16384  # starts handed to an engine at once, at most
ACCELERATOR_TILE = 1 << 20  # the same on an accelerator, which works on many at once (not measured)


def classify_many(
    equations: Equation,
    omegas: ArrayLike,
    *,
    rtol: NumberLike = 1e-8,
    atol: NumberLike | ArrayLike | None = None,
    max_steps: int | np.integer = MAX_STEPS,
    value: Value = True,
    engine: str = "auto",
    slow_flow: SlowFlow = "auto",
) -> Classification:
    """How dω/dτ = equation(ω) ends from each of N starts, on all cores or devices.

    An engine integrates many runs at once. Each ends when the equation's own `verdict` is certain,
    as in `classify`, whose table tells what `value` means.

    Args:
        equations: an equation with a `verdict`: one for all starts, or with a leading batch axis
            of N on every array field, as `TransverseReduced(delta=deltas)` has.
        omegas: starts ω₀, shape (N, 3), dimensionless, body axes. A start that is not finite, or
            has a subnormal component (which processors take for 0), is FAILED, and affects no
            other.
        rtol: relative tolerance of every step; `omega_inf_error` tells how exact ω∞ is.
        atol: absolute tolerance of every step, a number or shape (N,); None means 0, since errors
            are measured by the present |ω|, or rtol·|ω₀| for each start with `value=False`.
        max_steps: largest number of steps of a run; a run that needs more is predicted, or
            UNDECIDED.
        value: whether ω∞ is wanted, and the estimate of its error: True, "unchecked" or False.
        engine: "jax"; "native" (machine code, for float64 on processors; it needs llvmlite); or
            "auto", the fastest one that can run here.
        slow_flow: whether runs that would take more than `max_steps` are predicted, as by
            `predict`; see `classify`.

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
    starts = np.asarray(real("omegas", omegas, (-1, 3), batch=False))
    size = starts.shape[0]
    if size == 0:
        refuse("omegas", "hold at least one start", "holds none")
    rtol = tolerance("rtol", rtol)
    atol = absolute(atol, rtol, starts.T, label_only=value is False)
    steps = jnp.asarray(budget("max_steps", max_steps))
    single = is_single(equations)
    if not single:
        _check_batch(equations, size)
    check_slow_flow(slow_flow, equations)
    runs = _Runs(equations, single, starts, np.asarray(atol), rtol, steps)
    until, devices = stopping_rule(equations, value), worker_devices()
    every_run = runs.tile(0, size)
    engines = select_engines(engine, every_run[0], devices, until, classification_of)
    first = devices[0]
    if engines[first].has_own_threads:  # they share one queue
        threads = len(devices)
        return classify_block(*every_run, value, engines[first], first, slow_flow, threads)
    length = min(largest_tile(devices), power_of_two(-(-size // len(devices))))

    def work(job: int, device: Device) -> Classification:
        tile = runs.tile(job * length, length)
        return classify_block(*tile, value, engines[device], device, slow_flow)

    parts = dict(in_parallel(work, range(-(-size // length)), devices))
    tiles = [parts[job] for job in sorted(parts)]
    return jax.tree.map(lambda *fields: np.concatenate(fields, axis=-1)[..., :size], *tiles)


def classify_block(
    equation: Equation,
    omegas: Float[Array, "3 N"] | Float[np.ndarray, "3 N"],
    limits: Limits,
    value: Value,
    engine: Engine,
    device: Device,
    slow_flow: SlowFlow = False,
    threads: int = 1,
) -> Classification:
    """Classify N runs on one device; the fields of `equation` carry a trailing axis of N lanes."""
    if device.platform == "cpu" and np.any(lost := subnormal(omegas)):
        omegas = np.where(lost, np.nan, omegas)
    until = stopping_rule(equation, value)
    deciding: DecidingEquation = physical(equation)

    def run(omegas: Any, limits: Limits) -> Classification:
        queue = Queue(deciding, omegas, limits, until)
        runs = engine.classify(classification_of, queue, device, threads)
        return jax.device_get(runs)  # one transfer

    def classified(limits: Limits) -> Classification:
        runs = run(omegas, limits)
        if value is True:
            return with_error_estimates(runs, run, omegas, limits, omega_scale_of(deciding))
        return without_error_estimates(runs, value, np)

    def classified_where(followed: Bool[np.ndarray, "N"]) -> Classification:
        t1 = np.where(followed, limits.t1, 0.0)  # the others take no step
        return classified(replace(limits, t1=t1))

    motions = slow_motions(equation, omegas, slow_flow)
    if motions is None:
        return with_probability(classified(limits), np)
    return with_predictions(classified_where, motions, limits, value is False, slow_flow is True)


def largest_tile(devices: Sequence[Device]) -> int:
    """How many starts suit all of these devices."""
    return TILE if any(device.platform == "cpu" for device in devices) else ACCELERATOR_TILE


def power_of_two(least: int) -> int:
    """The smallest power of two that is at least `least` and 128, so that few sizes compile."""
    return max(128, 1 << (least - 1).bit_length())


class _Runs(NamedTuple):
    """The runs that `classify_many` is asked for."""

    equations: Equation
    single: bool
    """Whether it is one equation for all runs, rather than a batch."""
    starts: Float[np.ndarray, "N 3"]
    atol: Float[np.ndarray, "N"]
    rtol: Float[Array, ""]
    max_steps: Int[Array, ""]

    def tile(self, first: int, length: int) -> tuple[Any, Float[np.ndarray, "3 tile"], Limits]:
        """Some runs: the equation with its lanes behind, starts, limits.

        The last tile is filled up with runs that take no step. In NumPy, by views if the tile is
        full, since JAX would take as long as the machine code that works on it.
        """
        size, end = len(self.starts), first + length
        t1 = np.full(length, np.inf, self.starts.dtype)
        t1[max(size - first, 0) :] = 0.0
        full = end <= size
        runs: Any = slice(first, end) if full else np.minimum(np.arange(first, end), size - 1)

        def lanewise(leaf: Array) -> np.ndarray:
            numbers = np.asarray(leaf)
            if self.single:
                return np.broadcast_to(numbers[..., None], (*numbers.shape, length))
            return np.moveaxis(numbers[runs], 0, -1)

        arrays, rest = eqx.partition(self.equations, eqx.is_array)
        equation = eqx.combine(jax.tree.map(lanewise, arrays), rest)
        limits = Limits(self.rtol, self.atol[runs], t1, self.max_steps)
        return equation, self.starts[runs].T, limits


def _check_batch(equations: Equation, size: int) -> None:
    for leaf in jax.tree.leaves(eqx.filter(equations, eqx.is_array)):
        if leaf.ndim == 0 or leaf.shape[0] != size:
            refuse(
                "equations",
                f"be a single equation or have {size} entries on the leading axis of every field",
                f"has a field of shape {leaf.shape}",
            )
