"""Some of many runs: taken out of arrays along their trailing axis of lanes, and put back."""

from typing import Any, TypeVar

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Int

T = TypeVar("T")
Lanes = Int[np.ndarray, "some"]
"""The indices of some runs."""


def part_of(tree: T, lanes: Lanes, size: int) -> T:
    """Return the entries of some lanes, from arrays with a trailing axis of lanes; in NumPy."""

    def chosen(leaf: Any) -> Any:
        is_lanewise = eqx.is_array_like(leaf) and np.shape(leaf)[-1:] == (size,)
        return np.asarray(leaf)[..., lanes] if is_lanewise else leaf

    return jax.tree.map(chosen, tree)


def put_back(whole: T, lanes: Lanes, part: T) -> T:
    """Replace the entries of some lanes; in place if the arrays are writable."""

    def replaced(old: np.ndarray, new: np.ndarray) -> np.ndarray:
        both = old if old.flags.writeable else old.copy()
        both[..., lanes] = new
        return both

    return jax.tree.map(replaced, whole, part)
