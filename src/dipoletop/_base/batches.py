"""Methods of one object, applied to a batch of such objects."""

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import equinox as eqx

Method = TypeVar("Method", bound=Callable[..., Any])


def over_batch(axes: Callable[[Any], int]) -> Callable[[Method], Method]:
    """Return a decorator for methods of objects to which `jax.vmap` may add leading batch axes.

    Args:
        axes: function that returns the number of batch axes of an object, or refuses it.

    Returns:
        The decorator. For a batch, `vmap` calls the method for each object, and the result has the
        batch axes in front.
    """

    def decorate(method: Method) -> Method:
        @functools.wraps(method)
        def batched(self: Any, *args: Any, **kwargs: Any) -> Any:
            if axes(self) == 0:
                return method(self, *args, **kwargs)
            return eqx.filter_vmap(lambda each: batched(each, *args, **kwargs))(self)

        return batched  # pyright: ignore[reportReturnType]

    return decorate
