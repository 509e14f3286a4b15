"""What follows from an equation's structure alone, whatever the values it holds."""

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

Value = TypeVar("Value")


def of_structure(function: Callable[[Any], Value]) -> Callable[[Any], Value]:
    """Return the function, called with shapes in place of an equation's arrays, once for each.

    It may read shapes and types, and trace the equation, but no values.
    """

    @functools.lru_cache(maxsize=256)
    def remembered(structure: Any, kinds: tuple[Any, ...]) -> Value:
        return function(jax.tree.unflatten(structure, kinds))

    @functools.wraps(function)
    def call(equation: Any) -> Value:
        leaves, structure = jax.tree.flatten(equation)
        is_array = [isinstance(leaf, jax.Array | np.ndarray) for leaf in leaves]
        kinds = tuple(
            jax.ShapeDtypeStruct(leaf.shape, leaf.dtype) if array else leaf
            for leaf, array in zip(leaves, is_array, strict=True)
        )
        return remembered(structure, kinds)

    return call


@of_structure
def state_of(equation: Any) -> jax.ShapeDtypeStruct:
    """Return the shape and the type of a state of an equation."""
    return eqx.filter_eval_shape(lambda equation: equation.lift(jnp.zeros(3)), equation)
