"""Many paths in blocks of lanes, on all cores; each path has a random key of its own."""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._base.checks import concrete, finite, where_valid
from .._base.compiling import LANE_OPTIONS, special_numbers
from .._base.parallel import pool, worker_devices
from .._base.refusals import refuse
from .._base.tolerances import budget, whole

LANES = 512
"""Paths in a block: as many as keep the state of a step in the nearest caches."""
DRAWN = 16
"""Steps whose random numbers are drawn together; the number of steps is a multiple of it."""
MOST_STEPS = 5_000_000
"""Most steps of a path."""
State = Float[Array, "n *#lanes"]


@runtime_checkable
class Step(Protocol):
    """A step of paths, in lanes."""

    @property
    def draws(self) -> int:
        """The number of random numbers."""
        ...

    def __call__(self, t: Any, y: State, h: Any, z: Float[Array, "d *#lanes"]) -> State:
        """Return the state at t + h, with independent normal numbers z; y itself for h = 0."""
        ...


def kicked(change: Callable[..., State], y: State, t: Any = 0.0, h: Any = 0.0) -> State:
    """Return the state after a step of the classical Runge-Kutta method.

    With the noise at a constant rate in a step it converges in the sense of Stratonovich. The error
    of means is of fourth order in the step without noise, and of first order times the square of
    the variance of the noise.

    Args:
        change: the rate times the step, as a function of the state, and of the time.
        y: the state.
        t: the time.
        h: the step.
    """

    def stage(carry: tuple[State, State], weights: Any) -> tuple[Any, None]:
        last, total = carry
        ahead, share = weights
        last = change(y + ahead * last, t + ahead * h)
        return (last, total + share * last), None

    weights = jnp.array([0.0, 0.5, 0.5, 1.0]), jnp.array([1.0, 2.0, 2.0, 1.0]) / 6
    nothing = jnp.zeros_like(y)
    # A loop: the change is compiled once.
    return y + jax.lax.scan(stage, (nothing, nothing), weights)[0][1]


class Schedule(NamedTuple):
    """The steps of all paths."""

    begins: Any
    """Shape (S,)."""
    sizes: Any
    slots: Any
    """The index of the time in `ts` that a step leads towards."""


def schedule(ts: Float[np.ndarray, "T"], longest: Callable[[float], float]) -> Schedule:
    """Return steps that end at every time, none longer than `longest(t)` at its beginning.

    Args:
        ts: ascending times, from the start on.
        longest: the longest step that may begin at a time.
    """
    parts, total = [], 0
    for slot in range(1, len(ts)):
        t, end = float(ts[slot - 1]), float(ts[slot])
        while t < end:
            h = longest(t)
            rest = max(1, int(np.ceil((end - t) / h)))
            # So few steps that `longest` hardly changes meanwhile.
            count = min(rest, max(1, int(np.ceil((t - float(ts[0]) + h) / h / 4))))
            total += count
            if total > MOST_STEPS:
                must = f"be reached in at most {MOST_STEPS} steps"
                refuse("ts", must, f"are farther (a step lasts at most {h:.3g})")
            size = (end - t) / rest if count == rest else h
            begins = t + size * np.arange(count)
            parts.append(Schedule(begins, np.full(count, size), np.full(count, slot)))
            t = end if count == rest else t + size * count
    none = float(ts[-1]), 0.0, len(ts) - 1
    parts.append(Schedule(*(np.full(-total % DRAWN, value) for value in none)))
    return Schedule(*map(np.concatenate, zip(*parts, strict=True)))


def times(ts: Any) -> Float[np.ndarray, "T"]:
    """Return ascending times as an array of NumPy."""
    given = np.asarray(finite("ts", ts, (-1,), batch=False))
    if given.size < 2:
        refuse("ts", "hold at least two times", f"holds {given.size}")
    where_valid("ts", given, np.append(True, np.diff(given) > 0), "be in ascending order")
    return given


def starts_of(omega0: Any, n: Any) -> Float[np.ndarray, "3 n"]:
    """Return the ω₀ of n paths, from that of all or of each."""
    count = budget("n", n)
    starts = np.asarray(finite("omega0", omega0, (3,)))
    if starts.ndim == 2 and len(starts) != count:
        refuse("omega0", f"have shape (3,) or ({count}, 3)", f"has shape {starts.shape}")
    return np.broadcast_to(starts, (count, 3)).T


def follow(
    step: Step, starts: Float[Array, "n N"], plan: Schedule, seed: int
) -> Float[np.ndarray, "N T n"]:
    """Return the states of N paths at all times.

    Args:
        step: the step.
        starts: the starts of the paths.
        plan: the steps.
        seed: the seed; path i depends on (seed, i) only.
    """
    seed = whole("seed", seed, 0)
    if not concrete(step, starts):
        refuse("omega0", "be known (paths are computed by the host)", "is traced")
    n, kept = starts.shape[1], int(plan.slots[-1]) + 1
    lanes = np.pad(starts, ((0, 0), (0, -n % LANES)), mode="edge")
    count = len(plan.sizes) // DRAWN
    # Shapes that are powers of two, so that few programs are compiled.
    missing = _rounded_up(count, 64) - count
    arrays = [np.pad(x.reshape(-1, DRAWN), ((0, missing), (0, 0))) for x in plan]
    steps = Schedule(*map(jnp.asarray, arrays)), jnp.asarray(count)

    def block(first: int) -> Float[np.ndarray, "LANES T n"]:
        chosen = slice(first, first + LANES)
        path = jnp.asarray(np.arange(first, first + LANES))
        found = _compiled(
            step, lanes[:, chosen], path, jnp.asarray(seed), *steps, _rounded_up(kept, 8)
        )
        return np.moveaxis(np.asarray(found)[:kept], (0, 1, 2), (1, 2, 0))

    with special_numbers():
        parts = list(pool(len(worker_devices())).map(block, range(0, n, LANES)))
    return np.concatenate(parts)[:n]


def _rounded_up(n: int, least: int) -> int:
    return max(least, 1 << (n - 1).bit_length())


def _block(
    step: Any,
    start: Float[Array, "n L"],
    path: Int[Array, "L"],
    seed: Int[Array, ""],
    plan: Schedule,
    count: Any,
    kept: int,
) -> Float[Array, "T n L"]:
    """Return the states of a block of paths at all times, after `count` groups of steps."""
    keys = jax.vmap(jax.random.fold_in, (None, 0))(jax.random.key(seed), path)

    def drawn(number: Any, carry: Any) -> Any:
        def normal(key: Any) -> Float[Array, "b d"]:
            # Single precision: paths cannot show the difference, which takes half the time.
            key = jax.random.fold_in(key, number)
            return jax.random.normal(key, (DRAWN, step.draws), jnp.float32)

        z = jax.vmap(normal, out_axes=-1)(keys).astype(start.dtype)
        return jax.lax.scan(one, carry, (*(x[number] for x in plan), z))[0]

    def one(carry: Any, now: Any) -> tuple[Any, None]:
        y, saved = carry
        t, h, slot, z = now
        y = step(t, y, h, z)
        return (y, jax.lax.dynamic_update_index_in_dim(saved, y, slot, 0)), None

    saved = jnp.zeros((kept, *start.shape), start.dtype).at[0].set(start)
    _, saved = jax.lax.fori_loop(0, count, drawn, (start, saved))
    return saved


OPTIONS = LANE_OPTIONS | {"xla_backend_optimization_level": 3}  # it runs for long
_compiled: Any = eqx.filter_jit(_block, compiler_options=OPTIONS)  # pyright: ignore
