"""Modules whose `repr` shows their numbers."""

from typing import Any

import equinox as eqx
import jax
import numpy as np

from .checks import concrete

MOST = 9  # numbers of an array that are shown


class Shown(eqx.Module):
    """A module whose `repr` shows the values of small arrays, where other modules show types."""

    def __repr__(self) -> str:
        return eqx.tree_pformat(jax.tree.map(_value, self))


def _value(leaf: Any) -> Any:
    few = isinstance(leaf, jax.Array | np.ndarray) and concrete(leaf) and leaf.size <= MOST
    return leaf.tolist() if few else leaf
