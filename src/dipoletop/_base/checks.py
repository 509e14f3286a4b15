"""Checks of arguments: a bad known value raises an error; a bad traced value becomes NaN."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float
from jaxtyping import Real as RealOrInteger
from typing_extensions import TypeAliasType

from .forks import refuse_orphan
from .quantities import Quantity, WrongUnitError, plain
from .refusals import described, refuse
from .structure import of_structure, state_of

# Aliases with a name of their own, which `help` prints in place of what they stand for.
NumberLike = TypeAliasType(
    "NumberLike",
    float | int | np.floating | np.integer | RealOrInteger[np.ndarray | Array, ""] | Quantity,
)
"""A real number as an argument."""
ArrayLike = TypeAliasType(
    "ArrayLike", Sequence[Any] | RealOrInteger[np.ndarray | Array, "..."] | Quantity
)
"""Real numbers as an argument: an array of JAX or of NumPy, or nested sequences."""


def concrete(*values: Any) -> bool:
    """Return whether every leaf is a value, not a tracer."""
    return not any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(values))


def instance(name: str, value: Any, kind: Any, must: str = "") -> Any:
    """Return `value`; refuse it if it is not an instance of `kind`."""
    if not isinstance(value, kind):
        refuse(name, must or f"be a {kind.__name__}", described(value))
    return value


def flag(name: str, value: Any) -> bool:
    """Return a boolean; refuse a value that is merely truthy or falsy."""
    return bool(instance(name, value, bool | np.bool_, "be True or False"))


def names_of(name: str, value: Any) -> tuple[str, ...]:
    """Return one name, or several names, as a tuple."""
    if isinstance(value, str):
        return (value,)
    must = "be a name or a sequence of names"
    if not isinstance(value, Iterable) or (isinstance(value, np.ndarray) and value.ndim == 0):
        refuse(name, must, described(value))
    return tuple(instance(name, each, str, must) for each in value)


def without_unit(name: str, value: Any, unit: str | None) -> Any:
    """Return quantities of astropy or pint as plain numbers in a unit; None: dimensionless."""
    try:
        return plain(value, unit)
    except WrongUnitError as error:
        must = "be dimensionless" if unit is None else f"be in {unit} or a unit of its dimension"
        refuse(name, must, f"is {error}")


def shape_of(value: Any) -> tuple[int, ...]:
    """Return the shape of an argument; () where it has none, which a check will refuse."""
    try:
        return np.shape(value)
    except (TypeError, ValueError):
        return ()


def real(
    name: str,
    value: Any,
    shape: tuple[int, ...] = (),
    *,
    batch: bool = True,
    xp: Any = jnp,
    unit: str | None = None,
) -> Any:
    """Return `value` as a float array of `shape`, or (if `batch`) with one more axis in front.

    A length of -1 in `shape` stands for any length. `xp` is `jax.numpy`, or NumPy for known values,
    which does not copy an array of floats. A quantity is converted to `unit`.
    """
    refuse_orphan()  # here, since every computation checks its numbers first
    value = without_unit(name, value, unit)
    if isinstance(value, np.ma.MaskedArray) and np.ma.is_masked(value):
        refuse(name, "have no masked values", f"has {np.ma.count_masked(value)}")
    wanted = str(shape).replace("-1", "n")
    kind = f"be a real array of shape {wanted}" if shape else "be a real number"
    if any(isinstance(leaf, str | bytes) for leaf in jax.tree.leaves(value)):
        refuse(name, kind, f"is {value!r}")
    is_traced_or_on_device = isinstance(value, jax.Array) or not concrete(value)
    make = jnp if xp is jnp and is_traced_or_on_device else np  # NumPy compiles nothing
    try:
        array = make.asarray(value)
    except (TypeError, ValueError, OverflowError):
        refuse(name, kind, f"is {value!r}")
    if array.dtype == object:
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
    array = array.astype(jnp.result_type(float), copy=False)
    return array if xp is np else on_device(array)


def on_device(value: Any) -> Any:
    """Return an array of JAX; known numbers are copied.

    `jnp.asarray` would compile a program for each new shape of a NumPy array.
    """
    if not concrete(value):
        return jnp.asarray(value)
    if isinstance(value, jax.Array):
        return value
    with jax.ensure_compile_time_eval():
        return jax.device_put(np.array(value))  # a copy, since JAX may keep the memory


def on_host(array: Any) -> Any:
    """Return known numbers as an array of NumPy, whose operations compile nothing."""
    return np.asarray(array) if concrete(array) else array


def namespace(*arrays: Any) -> Any:
    """Return the module `numpy` if all arrays are NumPy's, else `jax.numpy`."""
    return jnp if any(isinstance(array, jax.Array) for array in arrays) else np


def or_nan(value: Any, valid: Any) -> Any:
    """Return `value` where `valid`, else NaN, with derivatives NaN, too.

    `jnp.where(valid, value, nan)` would have derivatives of 0 in reverse mode.
    """
    return value * jnp.where(valid, 1.0, jnp.nan)


def where_valid(
    name: str,
    value: Float[Array, "*s"] | Float[np.ndarray, "*s"],
    valid: Bool[Array, "..."] | Bool[np.ndarray, "..."] | np.bool_,
    must: str,
) -> Any:
    """Return `value`; where it is not `valid`, refuse a known value and make a traced one NaN.

    `valid` broadcasts from the left.
    """
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
    name: str,
    value: Any,
    shape: tuple[int, ...] = (),
    *,
    batch: bool = True,
    unit: str | None = None,
) -> Float[Array, "..."]:
    """Return a real array without NaN or inf; a quantity is converted to `unit`."""
    array = real(name, value, shape, batch=batch, unit=unit)
    known = on_host(array)
    return where_valid(name, array, namespace(known).isfinite(known), "be finite")


def positive(
    name: str,
    value: Any,
    shape: tuple[int, ...] = (),
    *,
    batch: bool = True,
    unit: str | None = None,
) -> Float[Array, "..."]:
    """Return a real array of finite numbers above 0; a quantity is converted to `unit`."""
    array = finite(name, value, shape, batch=batch, unit=unit)
    return where_valid(name, array, on_host(array) > 0, "be positive")


def not_negative(
    name: str, value: Any, shape: tuple[int, ...] = (), **options: Any
) -> Float[Array, "..."]:
    """Return a real array of finite numbers, 0 or above; options are those of `finite`."""
    array = finite(name, value, shape, **options)
    return where_valid(name, array, on_host(array) >= 0, "not be negative")


def subnormal(array: Any) -> np.ndarray:
    """Return a NumPy mask of the subnormal numbers.

    On CPUs JAX flushes them to 0, so that a start near an axis would get the verdict of a start
    *exactly* on it.
    """
    values = np.asarray(array)
    return (values != 0) & (np.abs(values) < np.finfo(values.dtype).tiny)


def check_equation(equation: Any, name: str = "equation") -> None:
    """Refuse a value that cannot be an equation of motion, such as a plain function."""
    must = "be an equation of motion, callable and with methods `lift(omega0)` and `omega(y)`"
    if getattr(equation, "is_noisy", False):
        kinds = "`noise.ensemble` and `noise.averaged_ensemble` follow many paths"
        refuse(name, f"be without noise ({kinds})", "has noise, so that it ends by chance")
    if isinstance(equation, type) or not callable(equation):
        refuse(name, must, described(equation))
    for method in ("lift", "omega"):
        if not _has_method(equation, method):
            refuse(name, must, f"{described(equation)}, which has no `{method}`")


def _has_method(value: Any, name: str) -> bool:
    """Return whether the class (faster to look up) or the object has the method."""
    return callable(getattr(type(value), name, None)) or callable(getattr(value, name, None))


def check_verdict(equation: Any, name: str = "equation") -> None:
    """Refuse a value that is not an equation, or an equation without a `verdict`."""
    check_equation(equation, name)
    if not _has_method(equation, "verdict"):
        must = "have a method `verdict(y)`, which says how its runs end"
        refuse(name, must, f"is {type(equation).__name__}, which has none")


def check_body(equation: Any) -> Any:
    """Return the `body` of an equation; refuse an equation without one."""
    body = getattr(equation, "body", None)
    if body is None:
        refuse("equation", "have a body", f"is of type {type(equation).__name__}, which has none")
    return body


@of_structure
def is_single(equation: Any) -> bool:
    """Return whether the equation maps one state to a rate of its shape, unlike a batch."""

    def rate(equation: Any) -> tuple[Any, Any]:
        y = equation.lift(jnp.zeros(3))
        return y, equation(0.0, y, None)

    try:
        y, change = eqx.filter_eval_shape(rate, equation)
    except (TypeError, ValueError) as error:  # as JAX raises where shapes do not fit
        # In a batch all arrays have the batch axis in front, and each equation fits one state.
        # Otherwise the fault is in the equation, and its author should see it.
        kinds = [x for x in jax.tree.leaves(equation) if isinstance(x, jax.ShapeDtypeStruct)]
        lengths = {kind.shape[:1] for kind in kinds}
        if len(lengths) != 1 or not _fits(eqx.filter_vmap(rate), equation):
            error.add_note(
                f"{type(equation).__name__} must give the rate of one state, or be a batch of "
                "equations whose arrays all have the axis of the batch in front."
            )
            raise
        return False
    return y.shape == change.shape


def _fits(function: Callable[[Any], Any], equation: Any) -> bool:
    try:
        eqx.filter_eval_shape(function, equation)
    except (TypeError, ValueError):
        return False
    return True


def check_single(equation: Any) -> None:
    """Refuse a value that is not an equation, and a batch of equations."""
    check_equation(equation)
    if not is_single(equation):
        batch = "is a batch of them (`jax.vmap`, `classify_many` and `sweep` take one)"
        refuse("equation", "be a single one", batch)


def is_whole_state(omega0: Any) -> bool:
    """Return whether an argument is a whole state rather than a start ω₀ of shape (3,)."""
    return real("omega0", omega0, (-1,), batch=False).shape != (3,)


def known_start(omega0: Any) -> Float[np.ndarray, "3"]:
    """Return a known start ω₀ as an array of NumPy."""
    start = real("omega0", omega0, (3,), batch=False, xp=np)
    where_valid("omega0", start, np.isfinite(start), "be finite")
    _refuse_subnormal(start)
    return start


def _refuse_subnormal(omega0: Any) -> None:
    if np.any(lost := subnormal(omega0)):
        least = np.finfo(omega0.dtype).tiny
        must = f"have components that are 0 or at least {least:.1e} in size"
        refuse("omega0", must, f"has {_some(np.asarray(omega0)[lost])}")


def checked_start(equation: Any, omega0: Any) -> Float[Array, "n"]:
    """Return ω₀, or a given whole state of the equation."""
    initial = finite("omega0", omega0, (-1,), batch=False)
    if concrete(initial):
        _refuse_subnormal(initial)
    if initial.shape != (3,):
        shape = state_of(equation).shape
        if initial.shape != shape:
            also = "" if shape == (3,) else f", or {shape} for a whole state"
            refuse("omega0", f"have shape (3,){also}", f"has shape {initial.shape}")
    return initial


def numbers_by_name(name: str, values: Any) -> dict[str, float]:
    """Return named numbers as a dict of finite floats, at least one."""
    if not isinstance(values, Mapping) or not values:
        refuse(name, "be a dict of named numbers", f"is {values!r}")
    return {
        key: float(finite(f"{name}[{key!r}]", value, batch=False)) for key, value in values.items()
    }


def corners_of_box(name: str, bounds: Any) -> tuple[Float[np.ndarray, "m"], Float[np.ndarray, "m"]]:
    """Return the lower and the upper corner of a box, a dict of pairs (low, high)."""
    if not isinstance(bounds, Mapping) or not bounds:
        refuse(name, "be a dict of pairs (low, high)", f"is {bounds!r}")
    pairs = []
    for key, pair in bounds.items():
        low, high = np.asarray(finite(f"{name}[{key!r}]", pair, (2,), batch=False))
        if not low < high:
            refuse(f"{name}[{key!r}]", "be a pair low < high", f"is {pair}")
        pairs.append((low, high))
    corners = np.array(pairs)
    return corners[:, 0], corners[:, 1]
