"""Quantities with a unit, of astropy or pint, as plain numbers; neither package is needed."""

import re
from typing import Any, NoReturn, Protocol, runtime_checkable

import numpy as np

ANGULAR = "rad/s"
"""The unit of angular speeds. Frequencies in Hz are taken, too, times 2π."""
_HERTZ = re.compile(r"hz\b|hertz|^[kMGT]?Hz$", re.IGNORECASE)
_TURNS = re.compile(r"rad|deg|arc|cyc|rev|turn|rpm|rps", re.IGNORECASE)


@runtime_checkable
class Quantity(Protocol):
    """A quantity of pint; those of astropy are arrays."""

    def m_as(self, units: Any) -> Any:
        """Return the numbers in other units."""
        ...


class WrongUnitError(ValueError):
    """A quantity cannot be expressed in the unit that is wanted; the message is its own unit."""


def is_quantity(value: Any) -> bool:
    """Return whether a value is a number, or an array, with a unit of astropy or pint."""
    of_astropy = hasattr(value, "unit") and hasattr(value, "to_value")
    return of_astropy or (hasattr(value, "units") and hasattr(value, "m_as"))


def plain(value: Any, unit: str | None) -> Any:
    """Return a quantity, or a list or tuple of quantities, as numbers in a unit.

    Args:
        value: any argument; what holds no quantity is returned as it is.
        unit: the unit, such as "kg*m**2"; None: dimensionless.

    Raises:
        WrongUnitError: a quantity of another dimension, or numbers with and without units together.
    """
    if is_quantity(value):
        return _angular(value) if unit == ANGULAR else _in_unit(value, unit or "")
    if not (isinstance(value, list | tuple) and _holds_quantity(value)):
        return value
    if not all(is_quantity(each) or isinstance(each, list | tuple) for each in value):
        raise WrongUnitError("in numbers with and without a unit")
    return [plain(each, unit) for each in value]


def _holds_quantity(value: Any) -> bool:
    if isinstance(value, list | tuple):
        return any(map(_holds_quantity, value))
    return is_quantity(value)


def _in_unit(quantity: Any, unit: str) -> Any:
    convert = quantity.to_value if hasattr(quantity, "to_value") else quantity.m_as
    try:
        return np.asarray(convert(unit))
    except Exception:  # each package has its own class of errors
        _refuse(quantity)


def _angular(quantity: Any) -> Any:
    """Return an angular speed in rad/s, 2πf of a frequency f."""
    name = _unit_of(quantity)
    if _HERTZ.search(name):
        return 2 * np.pi * _in_unit(quantity, "Hz")
    if not _TURNS.search(name):  # pint would take 1/s for rad/s
        _refuse(quantity)
    return _in_unit(quantity, ANGULAR)


def _unit_of(quantity: Any) -> str:
    return str(quantity.unit if hasattr(quantity, "to_value") else quantity.units)


def _refuse(quantity: Any) -> NoReturn:
    raise WrongUnitError(f"in {_unit_of(quantity) or 'no unit'}")
