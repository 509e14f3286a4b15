"""The outcomes of many runs, by the engines, on all cores or devices."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._base import stopping as _endings
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
from .._base.parallel import in_parallel, workers
from .._base.tolerances import MAX_STEPS, absolute, budget, tolerance
from .._base.types import Equation
from .._branch import march as manifold
from .._engines import jax_engine as lanes
from .._engines.select import engine_for, judged
from ..equations._common import scales_of
from .classification import Classification, Value, classification_of, stopping_rule
from .conditioning import with_error_estimates, without_error_estimates

TILE = 16384  # starts handed to the engine at once, at most


def classify_block(
    equation: Equation,
    omegas: Float[Array, "3 N"] | Float[np.ndarray, "3 N"],
    limits: lanes.Limits,
    value: Value,
    engine: Any,
    device: Any,
    threads: int = 1,
) -> Classification:
    """Classify a block: fields of `equation` carry a trailing axis N; runs on one device."""
    if device.platform == "cpu" and np.any(lost := subnormal(omegas)):
        omegas = np.where(lost, np.nan, omegas)
    how = {"until": stopping_rule(equation, value), "device": device, "threads": threads}
    equation = manifold.physical(equation)

    def run(omegas: Any, limits: lanes.Limits) -> Classification:
        found = judged(engine, classification_of, equation, omegas, limits, **how)
        return jax.tree.map(np.asarray, found)

    found = run(omegas, limits)
    if value is True:
        return with_error_estimates(found, run, omegas, limits, scales_of(equation))
    return without_error_estimates(found, value, np)


def classify_many(
    equations: Equation,
    omegas: ArrayLike,
    *,
    rtol: NumberLike = 1e-8,
    atol: NumberLike | ArrayLike | None = None,
    max_steps: int | np.integer = MAX_STEPS,
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
    until = stopping_rule(equations, value)
    crew = workers()
    block = _cut(whole, 0, size, single)
    engines = engines_for(engine, block[0], crew, until)
    if hasattr(engines[crew[0]], "judged"):  # threads of its own, which share one queue
        return classify_block(*block, value, engines[crew[0]], crew[0], threads=len(crew))
    tile = min(TILE, power_of_two(-(-size // len(crew))))

    def work(job: int, device: Any) -> Classification:
        part = _cut(whole, job * tile, tile, single)
        return classify_block(*part, value, engines[device], device)

    parts = dict(in_parallel(work, range(-(-size // tile)), crew))
    found = [parts[job] for job in sorted(parts)]
    return jax.tree.map(lambda *x: np.concatenate(x, axis=-1)[..., :size], *found)


def engines_for(
    engine: str, equation: Any, devices: Sequence[Any], until: _endings.Until
) -> dict[Any, Any]:
    """The engine of each device for `classify_block` with such equations."""
    equation = manifold.physical(equation)
    return {d: engine_for(engine, equation, d, until, classification_of) for d in set(devices)}


class _Runs(NamedTuple):
    """All that is asked of `classify_many`."""

    equations: Any
    starts: Float[np.ndarray, "N 3"]
    atol: Float[np.ndarray, "N"]
    rtol: Float[Array, ""]
    max_steps: Int[Array, ""]


def _cut(runs: _Runs, first: int, tile: int, single: bool) -> tuple[Any, Any, lanes.Limits]:
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
    limits = lanes.Limits(runs.rtol, runs.atol[at], t1, runs.max_steps)
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
