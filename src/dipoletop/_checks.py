"""Bad input: one sentence where the value is known, NaN where it is traced."""

from typing import Any, NoReturn

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

from ._forks import refuse_orphan


def concrete(*values: Any) -> bool:
    """Whether every leaf is a value, not a tracer."""
    return not any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(values))


def refuse(name: str, must: str, was: Any) -> NoReturn:
    """Raise the one sentence that every refusal has."""
    raise ValueError(f"Argument `{name}` must {must}, but {was}.")


def real(
    name: str, value: Any, shape: tuple[int, ...] = (), *, batch: bool = True
) -> Float[Array, "..."]:
    """`value` as a float array of the natural `shape`, or (if `batch`) one more axis in front.

    A length of -1 in `shape` stands for any length.
    """
    refuse_orphan()  # here, since whatever computes looks at its numbers first
    wanted = str(shape).replace("-1", "n")
    kind = f"be a real array of shape {wanted}" if shape else "be a real number"
    if any(isinstance(leaf, str | bytes) for leaf in jax.tree.leaves(value)):
        refuse(name, kind, f"is {value!r}")
    try:
        array = jnp.asarray(value)
    except (TypeError, ValueError, OverflowError):
        refuse(name, kind, f"is {value!r}")
    if array.dtype == bool or not (
        jnp.issubdtype(array.dtype, jnp.floating) or jnp.issubdtype(array.dtype, jnp.integer)
    ):
        refuse(name, kind, f"has dtype {array.dtype}")
    if array.ndim not in (len(shape), len(shape) + batch) or any(
        length not in (-1, got)
        for length, got in zip(reversed(shape), reversed(array.shape), strict=False)
    ):
        also = ", or one batch axis in front" if batch else ""
        refuse(name, f"have shape {wanted}{also}", f"has shape {array.shape}")
    return array.astype(jnp.result_type(float))


def or_nan(value: Any, valid: Any) -> Any:
    """`value` where `valid`, else NaN, as are its derivatives.

    (Of `jnp.where(valid, value, nan)` those backwards are 0.)
    """
    return value * jnp.where(valid, 1.0, jnp.nan)


def where_valid(
    name: str,
    value: Float[Array, "*s"],
    valid: Bool[Array, "..."] | Bool[np.ndarray, "..."] | np.bool_,
    must: str,
) -> Float[Array, "*s"]:
    """`value` where `valid` (which broadcasts from the left); else refuse it, or NaN if traced."""
    valid = valid.reshape(valid.shape + (1,) * (value.ndim - valid.ndim))
    if concrete(value, valid):
        if not np.all(valid):
            bad = np.asarray(value)[~np.broadcast_to(np.asarray(valid), value.shape)]
            refuse(name, must, f"is {bad.flat[0]}" if value.ndim == 0 else f"has {_some(bad)}")
        return value
    return or_nan(value, valid)


def _some(values: np.ndarray) -> str:
    shown = ", ".join(f"{v:g}" for v in values.flat[:3])
    return shown + (f" and {values.size - 3} more" if values.size > 3 else "")


def finite(
    name: str, value: Any, shape: tuple[int, ...] = (), *, batch: bool = True
) -> Float[Array, "..."]:
    """A real array without NaN or inf."""
    array = real(name, value, shape, batch=batch)
    return where_valid(name, array, jnp.isfinite(array), "be finite")


def subnormal(array: Any) -> np.ndarray:
    """Which numbers are too small for processors, where JAX takes them for 0; looked at in NumPy.

    A verdict about a start that is *exactly* on an axis would be wrong for them.
    """
    values = np.asarray(array)
    return (values != 0) & (np.abs(values) < np.finfo(values.dtype).tiny)


def initial_state(equation: Any, omega0: Any) -> Float[Array, "n"]:
    """The start: lifted from ω₀, or a whole state as it is."""
    whole = jax.eval_shape(equation.lift, jax.ShapeDtypeStruct((3,), jnp.result_type(float))).shape
    start = finite("omega0", omega0, (-1,), batch=False)
    if concrete(start) and np.any(lost := subnormal(start)):
        least = np.finfo(start.dtype).tiny
        must = f"have components that are 0 or at least {least:.1e} in size"
        refuse("omega0", must, f"has {_some(np.asarray(start)[lost])}")
    if start.shape == (3,):
        return equation.lift(start)
    if start.shape != whole:
        also = "" if whole == (3,) else f", or {whole} for a whole state"
        refuse("omega0", f"have shape (3,){also}", f"has shape {start.shape}")
    return start
