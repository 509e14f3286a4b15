"""Units of dipole moment and angular speed, and the checks of SI values."""

import math
import re
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from .._base.checks import finite, on_device, on_host, real, shape_of, where_valid, without_unit
from .._base.quantities import ANGULAR
from .._base.refusals import refuse

# CODATA 2022. `scipy.constants` has them, too, but takes 60 ms to import.
LIGHT = 299_792_458.0
"""The speed of light c, in m/s."""
CHARGE = 1.602_176_634e-19
"""The elementary charge, in C."""
PERMITTIVITY = 8.854_187_818_8e-12
"""The electric constant ε₀, in F/m."""
BOLTZMANN = 1.380_649e-23
"""Boltzmann's constant k, in J/K."""
HBAR = 1.054_571_817_646_156_4e-34
"""Planck's constant over 2π, in J s."""
DALTON = 1.660_539_068_92e-27
"""The atomic mass constant, in kg."""

RADIATION = 1 / (6 * math.pi * PERMITTIVITY * LIGHT**3)
"""k = 1/(6πε₀c³), the strength of the radiation torque, in kg m² s/(C m)²."""
DEBYE = 1e-21 / LIGHT
"""One debye, 1e-18 statC cm, in C m (c is its number in m/s)."""
STATCOULOMB_CM = 1e18 * DEBYE
"""The Gaussian unit of dipole moment, in C m."""

_TURN = 2 * math.pi
_UNITS = {
    "Hz": _TURN,
    "kHz": _TURN * 1e3,
    "MHz": _TURN * 1e6,
    "GHz": _TURN * 1e9,
    "THz": _TURN * 1e12,
    "rad/s": 1.0,
    "rpm": _TURN / 60,
}
"""Units of a rotation frequency, in rad/s; upper and lower case matter."""
_TEXT = re.compile(r"\s*((?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([A-Za-z/]+)\s*", re.ASCII)


def angular_speed(spin: Any) -> Float[Array, "*batch"]:
    """Compute Ω = 2πf in rad/s from a text such as "1 GHz", or take a number in rad/s.

    Args:
        spin: a number in rad/s, shape () or (B,); or a text, a number with its unit Hz, kHz, MHz,
            GHz, THz, rad/s or rpm; or a quantity of astropy or pint, a frequency or an angular
            speed.

    Returns:
        Ω, rad/s, of the same shape; of shape () for a text.

    Raises:
        ValueError: a negative `spin`, one that is not finite, or a text without such a unit.

    Example:
        >>> print(f"{angular_speed('1 GHz'):.6e}, {angular_speed('3000rpm'):.6f}")
        6.283185e+09, 314.159265
        >>> float(angular_speed(2.5))
        2.5
    """
    return speed_in_rad("spin", spin)


def speed_in_rad(name: str, value: Any) -> Float[Array, "*batch"]:
    """Return `angular_speed` of an argument that errors call `name`."""
    if isinstance(value, str):
        given = _TEXT.fullmatch(value)
        if given is None or given[2] not in _UNITS:
            refuse(name, f"be a number with a unit among {', '.join(_UNITS)}", f"is {value!r}")
        value = float(given[1]) * _UNITS[given[2]]
    speed = finite(name, value, unit=ANGULAR)
    return where_valid(name, speed, on_host(speed) >= 0, "not be negative")


def magnetic_dipole(moment: Any) -> Float[Array, "3"]:
    """Return d = m/c, the electric dipole that radiates as a magnetic moment m does.

    Args:
        moment: m in A m², shape (3,).

    Returns:
        d in C m, shape (3,).

    Raises:
        ValueError: a `moment` of another shape, or not finite.

    Example:
        >>> magnetic_dipole([299792458.0, 0.0, 0.0]).tolist()
        [1.0, 0.0, 0.0]
    """
    return on_device(on_host(finite("moment", moment, (3,), batch=False, unit="A*m**2")) / LIGHT)


def positive_si(name: str, value: Any, unit: str, shape: tuple[int, ...] = ()) -> Any:
    """Return a positive number in an SI unit, or an array of them; in NumPy if it is known."""
    array = on_host(finite(name, value, shape, batch=False, unit=unit))
    if array.dtype != jnp.float64:
        hint = 'jax.config.update("jax_enable_x64", True) switches float64 on'
        refuse(name, "be float64", f"is {array.dtype}, which ends near 1e-38 ({hint})")
    return where_valid(name, array, array > 0, "be positive")


def numbers(name: str, value: Any, unit: str | None = None) -> Float[Array, "..."]:
    """Return real numbers of any shape; a quantity is converted to `unit`."""
    value = without_unit(name, value, unit)
    return real(name, value, shape_of(value), batch=False)


def finite_numbers(name: str, value: Any, unit: str) -> Float[Array, "..."]:
    """Return finite numbers of any shape; a quantity is converted to `unit`."""
    value = without_unit(name, value, unit)
    return finite(name, value, shape_of(value), batch=False)
