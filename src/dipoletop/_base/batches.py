"""Methods of one object, applied to a batch of such objects."""

import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx


def over_batch(axes: Callable[[Any], int]) -> Callable[[Any], Any]:
    """A decorator for methods of objects that `jax.vmap` may give batch axes in front.

    Args:
        axes: gives the number of batch axes of an object; it may refuse the object, too.

    Returns:
        The decorator. Of a batch, the method is called for each object by `vmap`, and its result
        has the batch axes in front.
    """

    def decorate(method: Any) -> Any:
        @functools.wraps(method)
        def batched(self: Any, *args: Any, **kwargs: Any) -> Any:
            if axes(self) == 0:
                return method(self, *args, **kwargs)
            return eqx.filter_vmap(lambda each: batched(each, *args, **kwargs))(self)

        return batched

    return decorate
