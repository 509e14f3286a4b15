"""Bad input: one sentence where the value is known, NaN where it is traced."""

import functools
from collections.abc import Iterable, Mapping
from typing import Any, NoReturn

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

from .forks import refuse_orphan

LONGEST = 2000  # characters of what a refusal shows of a value
FLAG = (bool, np.bool_)


def concrete(*values: Any) -> bool:
    """Whether every leaf is a value, not a tracer."""
    return not any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(values))


def refuse(name: str, must: str, was: Any) -> NoReturn:
    """Raise the one sentence that every refusal has."""
    shown = " ".join(str(was).split())  # some values print over many lines
    if len(shown) > LONGEST:
        shown = shown[:LONGEST] + " …"
    raise ValueError(f"Argument `{name}` must {must}, but {shown}.")


def described(value: Any) -> str:
    """What a value of a wrong kind is, in few words."""
    if isinstance(value, type):
        return f"is the class {value.__name__}"
    if value is None or isinstance(value, bool | int | float | complex | str | bytes):
        return f"is {value!r}"
    return f"is of type {type(value).__name__}"


def instance(name: str, value: Any, kind: Any, must: str = "") -> Any:
    """`value` if it is of that class."""
    if not isinstance(value, kind):
        refuse(name, must or f"be a {kind.__name__}", described(value))
    return value


def flag(name: str, value: Any) -> bool:
    """True or False, and nothing that merely counts as such."""
    return bool(instance(name, value, FLAG, "be True or False"))


def names_of(name: str, value: Any) -> tuple[str, ...]:
    """One name, or several of them."""
    if isinstance(value, str):
        return (value,)
    must = "be a name or a sequence of names"
    found = tuple(instance(name, value, Iterable, must))
    for each in found:
        instance(name, each, str, must)
    return found


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


def check_equation(equation: Any, name: str = "equation") -> None:
    """Refuse what cannot be an equation of motion, such as a plain function."""
    must = "be an equation of motion, callable and with methods `lift(omega0)` and `omega(y)`"
    if isinstance(equation, type) or not callable(equation):
        refuse(name, must, described(equation))
    for method in ("lift", "omega"):
        if not callable(getattr(equation, method, None)):
            refuse(name, must, f"{described(equation)}, which has no `{method}`")


def check_verdict(equation: Any, name: str = "equation") -> None:
    """Refuse what is no equation, or cannot say how its runs end."""
    check_equation(equation, name)
    if not callable(getattr(equation, "verdict", None)):
        refuse(
            name,
            "have a method `verdict(y)`, which says how its runs end",
            f"is {type(equation).__name__}, which has none",
        )


def check_body(equation: Any) -> None:
    """Refuse an equation of which no body is known."""
    if not hasattr(equation, "body"):
        refuse("equation", "have a body", f"is of type {type(equation).__name__}, which has none")


def is_single(equation: Any) -> bool:
    """Whether the equation maps one state to one rate of the same shape."""
    leaves, structure = jax.tree.flatten(equation)
    kinds = tuple(jax.ShapeDtypeStruct(x.shape, x.dtype) if _many(x) else x for x in leaves)
    return _maps_one_state(structure, kinds)


def _many(leaf: Any) -> bool:
    return isinstance(leaf, jax.Array | np.ndarray)


@functools.lru_cache(maxsize=256)
def _maps_one_state(structure: Any, kinds: tuple[Any, ...]) -> bool:
    def rate(equation: Any) -> tuple[Any, Any]:
        y = equation.lift(jnp.zeros(3))
        return y, equation(0.0, y, None)

    equation = jax.tree.unflatten(structure, kinds)
    try:
        y, change = eqx.filter_eval_shape(rate, equation)
    except Exception:
        # One with a batch in front does not fit a single state, but each of the batch does; else
        # the fault is the equation's own.
        if not _fits_lane_by_lane(rate, equation):
            raise
        return False
    return y.shape == change.shape


def _fits_lane_by_lane(rate: Any, equation: Any) -> bool:
    try:
        eqx.filter_eval_shape(eqx.filter_vmap(rate), equation)
    except Exception:  # that of the single state is what the user is to see
        return False
    return True


def check_single(equation: Any) -> None:
    """Refuse what is no equation, or a batch of them, where one is wanted."""
    check_equation(equation)
    if not is_single(equation):
        batch = "is a batch of them (`jax.vmap`, `classify_many` and `sweep` take one)"
        refuse("equation", "be a single one", batch)


def is_whole_state(omega0: Any) -> bool:
    """Whether it is not a start ω₀ of shape (3,), but a state as an equation has it."""
    return real("omega0", omega0, (-1,), batch=False).shape != (3,)


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


def numbers_by_name(name: str, values: Any) -> dict[str, float]:
    """A dict of finite numbers, at least one."""
    if not isinstance(values, Mapping) or not values:
        refuse(name, "be a dict of named numbers", f"is {values!r}")
    return {
        key: float(finite(f"{name}[{key!r}]", value, batch=False)) for key, value in values.items()
    }


def corners_of_box(name: str, bounds: Any) -> tuple[Float[np.ndarray, "m"], Float[np.ndarray, "m"]]:
    """The lower and the upper corner of a box, a dict of pairs (low, high)."""
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
