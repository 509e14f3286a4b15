"""Some of many runs: taken out of arrays whose trailing axis is that of the lanes, and put back."""

from typing import Any, TypeVar

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool

T = TypeVar("T")


def part_of(tree: T, which: Bool[np.ndarray, "N"]) -> T:
    """What belongs to the marked lanes, of arrays with a trailing axis of N; in NumPy."""

    def chosen(leaf: Any) -> Any:
        is_lanewise = eqx.is_array_like(leaf) and np.shape(leaf)[-1:] == which.shape
        return np.asarray(leaf)[..., which] if is_lanewise else leaf

    return jax.tree.map(chosen, tree)


def merged(whole: T, which: Bool[np.ndarray, "N"], part: T) -> T:
    """The arrays with other entries for the marked lanes, which may be of other types."""

    def replaced(old: Any, new: Any) -> np.ndarray:
        both = np.array(old)
        both[..., which] = new
        return both

    return jax.tree.map(replaced, whole, part)
