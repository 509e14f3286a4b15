"""Tolerances and budgets: what they must be, and what `None` means."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .checks import concrete, real, refuse
from .linalg import length

MAX_STEPS = 50_000
MOST = 2**31 - 1  # what engines count in 32 bits
SETTINGS = ("rtol", "atol", "max_steps", "devices", "engine")  # of `sweep`


def tolerance(name: str, value: Any) -> Float[Array, ""]:
    """A relative tolerance that the floating-point type in use can meet."""
    array = real(name, value)
    least = 20 * float(jnp.finfo(array.dtype).eps)
    if concrete(array) and not (array.ndim == 0 and least <= float(array) < 1):
        hint = ""
        if array.dtype == np.float32:
            hint = ' (float64 is off; jax.config.update("jax_enable_x64", True) switches it on)'
        shown = f"{float(array):g}" if array.ndim == 0 else f"of shape {array.shape}"
        refuse(name, f"lie between {least:.1e} and 1 in {array.dtype}", f"is {shown}{hint}")
    return array


def absolute(
    atol: Any,
    rtol: Float[Array, ""],
    start: Float[Array, "..."],
    axis: int = 0,
    *,
    label_only: bool = False,
) -> Float[Array, "*n"]:
    """`atol`; for None 0, since errors are measured by the present |ω|.

    A label does not depend on how exact a motion is that has become slow: if no more is wanted,
    None means rtol·|ω₀|. The components of ω₀ are on the first or on the last axis, 0 or -1.
    """
    if atol is None:
        return _scaled(rtol, start, label_only, axis)
    shape = start.shape[1:] if axis == 0 else start.shape[:-1]
    return jnp.broadcast_to(check_atol(atol, shape), shape)


def check_atol(atol: Any, shape: tuple[int, ...] = ()) -> Float[Array, "..."]:
    """An absolute tolerance: one number, or one for each start."""
    array = real("atol", atol)
    if array.shape not in ((), shape):
        refuse("atol", f"be a number or have shape {shape}", f"has shape {array.shape}")
    if concrete(array) and not bool(jnp.all((array >= 0) & (array < jnp.inf))):
        refuse("atol", "be finite and not negative, or None", f"is {atol}")
    return array


@functools.partial(jax.jit, static_argnames=("label_only", "axis"))
def _scaled(
    rtol: Float[Array, ""], start: Float[Array, "..."], label_only: bool, axis: int
) -> Float[Array, "*n"]:
    size = length(jnp.moveaxis(start, axis, 0))
    # A start at rest stays there; any positive tolerance will do for it.
    return rtol * jnp.where(size > 0, size if label_only else 0.0, 1.0)


def budget(name: str, value: Any) -> int:
    """A whole number of steps, or of other things; more than 2³¹ − 1 would wrap where counted."""
    return whole(name, value, 1, "be a positive whole number", MOST)


def whole(
    name: str,
    value: Any,
    least: int,
    must: str = "be a whole number, not negative",
    most: int = 2**63 - 1,
) -> int:
    """A whole number from `least` up to `most`, a signed word of 64 bits if nothing is said."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        refuse(name, must, f"is {value!r}")
    if value > most:
        refuse(name, f"be at most {most}", f"is {value}")
    return int(value)


def check_settings(settings: dict[str, Any], also: tuple[str, ...] = ()) -> None:
    """Refuse names that are no settings of the runs, nor among those that are allowed `also`.

    Where the fate is wanted, `value` is no setting: the sign of ω∞ is a part of the fate.
    """
    allowed = (*SETTINGS, *also)
    for name in settings:
        if name not in allowed:
            refuse("settings", f"be among {', '.join(allowed)}", f"hold {name!r}")
