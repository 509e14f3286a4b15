"""The outcomes of many runs, by the engines, on all cores or devices."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from .._base.checks import ArrayLike, NumberLike, check_verdict, concrete, is_single, real
from .._base.parallel import Device, in_parallel, worker_devices
from .._base.refusals import refuse
from .._base.tolerances import MAX_STEPS
from .._base.types import Equation
from .._engines.interface import Limits, power_of_two
from .blocks import Place, classify_block
from .classification import Classification, Value
from .memory_limits import largest_tile
from .run_settings import RunSettings
from .slow_runs import SlowFlow

PIECE = 131_072  # largest number of starts for an engine that need not compile for their number
SHARED = 4096  # starts for each thread up to which threads share a queue


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
    """Classify how dω/dτ = equation(ω) ends from each of N starts, on all cores or devices.

    An engine integrates many runs at once. Each ends when the equation's own `verdict` is certain,
    as in `classify`, whose table explains `value`.

    Args:
        equations: an equation with a `verdict`: one for all starts, or with a leading batch axis
            of N on every array field, as `TransverseReduced(delta=deltas)` has.
        omegas: starts ω₀, shape (N, 3), dimensionless, body axes. A start that is not finite, or
            has a subnormal component (which processors take for 0), is FAILED, and affects no
            other.
        rtol: relative tolerance of every step; for the error of ω∞ see `omega_inf_error`.
        atol: absolute tolerance of every step, a number or shape (N,); None means 0, since errors
            are measured by the present |ω|; or, with `value=False`, rtol·|ω₀| for each start of a
            top whose slow motions all have the same outcome.
        max_steps: largest number of steps of a run; a run that needs more is predicted, or
            UNDECIDED.
        value: whether ω∞ is wanted, and the estimate of its error: True, "unchecked" or False.
            With False, the native engine runs the tops and bodies of this library at rtol = 1e-4
            first, and again at `rtol` where the label is in doubt; `time` and `steps` belong to
            the last run of a start.
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
    starts = real("omegas", omegas, (-1, 3), batch=False, xp=np)
    size = starts.shape[0]
    if size == 0:
        refuse("omegas", "hold at least one start", "holds none")
    single = is_single(equations)
    if not single:
        _check_batch(equations, size)
    settings = RunSettings(rtol, atol, max_steps, value, engine, slow_flow).checked(equations, size)
    runs, devices = Runs(equations, single, starts, settings), worker_devices()
    every_run = runs.tile(0, size)
    engines = settings.engines(every_run[0], devices)
    first, threads = devices[0], len(devices)
    # Few runs share one queue, so that no thread waits for the longest runs of another. So do
    # labels, for which hardly any work is left outside the engine.
    if engines[first].has_own_threads and (value is False or size <= SHARED * threads):
        return classify_block(*every_run, settings, Place(engines[first], first, threads))
    if engines[first].compiles_for_size:
        length = min(largest_tile(devices), power_of_two(-(-size // threads)))
    else:  # the same number of pieces for every thread
        length = -(-size // (threads * -(-size // (threads * PIECE))))

    def work(job: int, device: Device) -> Classification:
        tile = runs.tile(job * length, length)
        return classify_block(*tile, settings, Place(engines[device], device))

    parts = dict(in_parallel(work, range(-(-size // length)), devices))
    tiles = [parts[job] for job in sorted(parts)]
    return jax.tree.map(lambda *fields: np.concatenate(fields, axis=-1)[..., :size], *tiles)


class Runs(NamedTuple):
    """The runs of a call of `classify_many`."""

    equations: Equation
    single: bool
    """Whether there is one equation for all runs, rather than a batch."""
    starts: Float[np.ndarray, "N 3"]
    settings: RunSettings

    def tile(self, first: int, length: int) -> tuple[Any, Float[np.ndarray, "3 tile"], Limits]:
        """Return the equation with its lanes behind, the starts and the limits of some runs.

        The last tile is padded with runs that take no step. The arrays are of NumPy, and views if
        the tile is full: JAX would take as long to copy as the machine code takes to run.
        """
        size = len(self.starts)
        places = np.arange(first, first + length)
        runs: Any = slice(first, first + length)
        if first + length > size:
            runs = np.minimum(places, size - 1)

        def lanewise(leaf: Array | np.ndarray) -> np.ndarray:
            numbers = np.asarray(leaf)
            if self.single:
                return np.broadcast_to(numbers[..., None], (*numbers.shape, length))
            return np.moveaxis(numbers[runs], 0, -1)

        arrays, rest = eqx.partition(self.equations, eqx.is_array)
        equation = eqx.combine(jax.tree.map(lanewise, arrays), rest)
        settings, omegas = self.settings, self.starts[runs].T
        if np.ndim(settings.atol):
            settings = settings._replace(atol=np.asarray(settings.atol)[runs])
        return equation, omegas, settings.limits(equation, omegas, places < size)


def _check_batch(equations: Equation, size: int) -> None:
    for leaf in jax.tree.leaves(eqx.filter(equations, eqx.is_array)):
        if leaf.ndim == 0 or leaf.shape[0] != size:
            entries = f"{size} entries on the leading axis of every field"
            must = f"be a single equation or have {entries}"
            refuse("equations", must, f"has a field of shape {leaf.shape}")
