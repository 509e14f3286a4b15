"""What is said of one object, said of a batch of them."""

import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx


def over_batch(axes: Callable[[Any], int]) -> Callable[[Any], Any]:
    """For methods of an object whose arrays may all have batch axes in front, as from `jax.vmap`.

    Args:
        axes: the number of batch axes of an object; it may refuse it, too.

    Returns:
        A decorator: the method of each, with the batch axes in front of what it gives.
    """

    def decorate(method: Any) -> Any:
        @functools.wraps(method)
        def of(self: Any, *given: Any, **named: Any) -> Any:
            if axes(self) == 0:
                return method(self, *given, **named)
            return eqx.filter_vmap(lambda one: of(one, *given, **named))(self)

        return of

    return decorate
