"""Parts of many runs: division of blocks that do not fit into the memory of a device.

Some of many runs are taken out of arrays along their trailing axis of lanes, and put back.
"""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Int

from .._base.parallel import Device

T = TypeVar("T")
Lanes = Int[np.ndarray, "some"]
"""The indices of some runs."""
SMALLEST = 128  # runs of a block that is not divided further
PER_START = 4096  # most bytes of a run, its share of the program's arrays included
TILE = 16384  # largest number of starts of one call of an engine
ACCELERATOR_TILE = 1 << 20  # the same on an accelerator, with its many lanes (not measured)

_fitting: dict[Device, int] = {}
"""How many runs fit, on the devices whose memory was exhausted."""


def largest_tile(devices: Sequence[Any]) -> int:
    """Return the number of starts of a tile for some devices, by their kind and free memory."""
    if any(device.platform == "cpu" for device in devices):
        return TILE
    starts = min(_free_memory(device) for device in devices) // PER_START
    return min(max(1 << (max(starts, 1).bit_length() - 1), TILE), ACCELERATOR_TILE)


def _free_memory(device: Any) -> int:
    """Return the free bytes; as many as the largest tile takes if they are not known."""
    stats = device.memory_stats() or {}
    if "bytes_limit" not in stats:
        return ACCELERATOR_TILE * PER_START
    return stats["bytes_limit"] - stats.get("bytes_in_use", 0)


def in_fitting_parts(run: Callable[..., T], runs: Any, size: int, device: Device) -> T:
    """Return `run(*runs)`, computed in halves, quarters, … as long as memory is exhausted.

    Args:
        run: a function of runs in NumPy to a pytree of arrays with the same trailing axis.
        runs: its arguments, pytrees of arrays.
        size: the number of runs, the length of the trailing axes.
        device: the device of the runs.
    """
    if size <= _fitting.get(device, size):
        try:
            return run(*runs)
        except (MemoryError, jax.errors.JaxRuntimeError) as error:
            exhausted = isinstance(error, MemoryError) or "RESOURCE_EXHAUSTED" in str(error)
            if size <= SMALLEST or not exhausted:
                raise
            _fitting[device] = max(size // 2, SMALLEST)
    half = size // 2
    parts = [
        in_fitting_parts(run, part_of(runs, lanes, size), len(lanes), device)
        for lanes in (np.arange(half), np.arange(half, size))
    ]
    return jax.tree.map(lambda *fields: np.concatenate(fields, axis=-1), *parts)


def part_of(tree: T, lanes: Lanes, size: int) -> T:
    """Return the entries of some lanes, from arrays with a trailing axis of lanes; in NumPy."""

    def chosen(leaf: Any) -> Any:
        is_lanewise = eqx.is_array_like(leaf) and np.shape(leaf)[-1:] == (size,)
        return np.take(np.asarray(leaf), lanes, -1) if is_lanewise else leaf

    return jax.tree.map(chosen, tree)


def put_back(whole: T, lanes: Lanes, part: T) -> T:
    """Replace the entries of some lanes; in place if the arrays are writable."""

    def replaced(old: np.ndarray, new: np.ndarray) -> np.ndarray:
        both = old if old.flags.writeable else old.copy()
        both[..., lanes] = new
        return both

    return jax.tree.map(replaced, whole, part)
