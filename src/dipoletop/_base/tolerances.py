"""Tolerances and budgets of runs: their checks, and the meaning of `None`."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .checks import concrete, on_device, on_host, real
from .linalg import length
from .refusals import refusal, refuse

MAX_STEPS = 50_000
MOST = 2**31 - 1  # engines count steps in 32 bits
TANGENT_SLACK = 10.0
"""Relative tolerance of a first variation in units of the tolerance of the state.

Derivatives are then less exact than values, except next to a boundary. They are least exact for
bodies whose precession gets out of phase: their errors grow with the number of turns of a run,
about as its square."""
TANGENT_SLACK_ALONE = 3.0
"""`TANGENT_SLACK` for a single initial condition, where steps cost less than compilation."""
TANGENT_FLOOR = 1e-2
"""Size of a variation (for a change by 1) in units of |ω| below which it need not be exact."""
SETTINGS = "rtol", "atol", "max_steps", "devices", "engine", "slow_flow"  # passed on to `sweep`


class Tolerances(NamedTuple):
    """The allowed error of a step in each component: atol + rtol·size, in units of 1/τ₀.

    `error_scale_of` the equation defines the size of a component.
    """

    rtol: Float[Array, ""]
    """Relative tolerance, the same for all lanes."""
    atol: Float[Array, "*lanes"]
    """Absolute tolerance, one for each lane."""


SWITCH_ON = 'Float64 is off; jax.config.update("jax_enable_x64", True) switches it on'


def step_tolerances(
    rtol: Any, atol: Any, omega0: Float[Array, "3"], exact_when_slow: Any = True
) -> Tolerances:
    """Return the tolerances of a run from ω₀; see `absolute` for atol = None."""
    rtol = tolerance("rtol", rtol)
    return Tolerances(rtol, jnp.asarray(absolute(atol, rtol, omega0, exact_when_slow)))


def tolerance(name: str, value: Any, xp: Any = jnp) -> Any:
    """Return a relative tolerance, checked against the floating-point type; for `xp` see `real`."""
    array = real(name, value, xp=xp)
    least = 20 * float(jnp.finfo(array.dtype).eps)
    if concrete(array) and not (array.ndim == 0 and least <= float(array) < 1):
        shown = f"{float(array):g}" if array.ndim == 0 else f"of shape {array.shape}"
        must = f"lie between {least:.1e} and 1 in {array.dtype}"
        if array.dtype == np.float32:
            raise ValueError(f"{SWITCH_ON}. {refusal(name, must, f'is {shown}')}")
        refuse(name, must, f"is {shown}")
    return array


def absolute(
    atol: Any,
    rtol: Float[Array, ""] | Float[np.ndarray, ""],
    omega0: Float[Array, "3 *n"] | Float[np.ndarray, "3 *n"],
    exact_when_slow: Any = True,
) -> Float[Array, "*n"] | Float[np.ndarray, "*n"]:
    """Return the absolute tolerance; None means 0, since errors are relative to the present |ω|.

    If motions need not be exact once they are slow, None means rtol·|ω₀|. `exact_when_slow` is one
    boolean, or one for each start.
    """
    if atol is None and concrete(rtol, omega0, exact_when_slow):
        known = np.asarray(omega0), np.asarray(exact_when_slow)
        found = _default_atol_in_numpy(rtol, *known)
        return found if isinstance(omega0, np.ndarray) else on_device(found)
    if atol is None:
        return _default_atol(jnp.asarray(rtol), jnp.asarray(omega0), jnp.asarray(exact_when_slow))
    given, shape = check_atol(atol, omega0.shape[1:]), omega0.shape[1:]
    return given if given.shape == shape else jnp.broadcast_to(given, shape)


def check_atol(atol: Any, shape: tuple[int, ...] = ()) -> Float[Array, "..."]:
    """Return an absolute tolerance: one number, or one for each start."""
    array = real("atol", atol)
    if array.shape not in ((), shape):
        refuse("atol", f"be a number or have shape {shape}", f"has shape {array.shape}")
    known = on_host(array)
    if concrete(array) and not np.all((known >= 0) & (known < np.inf)):
        refuse("atol", "be finite and not negative, or None", f"is {atol}")
    return array


def _default_atol(
    rtol: Float[Array, ""], omega0: Float[Array, "3 *n"], exact_when_slow: Bool[Array, "..."]
) -> Float[Array, "*n"]:
    size = length(omega0)
    # A top at rest stays at rest; any positive tolerance serves it.
    return rtol * jnp.where(size > 0, jnp.where(exact_when_slow, 0.0, size), 1.0)


def _default_atol_in_numpy(
    rtol: Any, omega0: Float[np.ndarray, "3 *n"], exact_when_slow: Bool[np.ndarray, "..."]
) -> Float[np.ndarray, "*n"]:
    """Return `_default_atol` of known starts; JAX would compile anew for each number of them."""
    with np.errstate(all="ignore"):
        # In place: getting memory from the system takes longer than computing.
        atol = np.asarray(np.einsum("i...,i...->...", omega0, omega0))
        if np.all(atol > np.finfo(atol.dtype).tiny):
            if np.all(exact_when_slow):
                return np.zeros_like(atol)
            atol = np.multiply(np.sqrt(atol, out=atol), float(rtol), out=atol)
            atol[np.broadcast_to(exact_when_slow, atol.shape)] = 0.0
            return atol
        most = np.max(np.abs(omega0), axis=0)  # squares may have underflowed
        unit = np.where(most > 0, most, 1.0)
        size = most * np.sqrt(np.sum(np.square(omega0 / unit), axis=0))
    scale = np.where(size > 0, np.where(exact_when_slow, 0.0, size), 1.0)
    return np.asarray(float(rtol) * scale, omega0.dtype)


def budget(name: str, value: Any) -> int:
    """Return a positive whole number, such as of steps, that fits in 32 bits."""
    return whole(name, value, 1, "be a positive whole number", MOST)


def whole(
    name: str,
    value: Any,
    least: int,
    must: str = "be a whole number, not negative",
    most: int = 2**63 - 1,
) -> int:
    """Return a whole number from `least` to `most`, by default the largest of 64 bits."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        refuse(name, must, f"is {value!r}")
    if value > most:
        refuse(name, f"be at most {most}", f"is {value}")
    return int(value)


def check_settings(settings: dict[str, Any], also: tuple[str, ...] = ()) -> None:
    """Refuse names that are neither settings of runs nor in `also`.

    `value` is not a setting where the fate is computed, since the fate includes the sign of ω∞.
    """
    allowed = (*SETTINGS, *also)
    for name in settings:
        if name not in allowed:
            refuse("settings", f"be among {', '.join(allowed)}", f"hold {name!r}")
