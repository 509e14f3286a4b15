"""The schema of a basin: its columns and customary axes, with types, units and meanings."""

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from jaxtyping import Float
from numpy import nan, ndarray

from .._base.refusals import refuse
from .._base.types import Outcome, Regime, Stop


class ColumnSpec(NamedTuple):
    """The type, unit and meaning of the numbers of a column."""

    dtype: str
    unit: str
    meaning: str
    members: Iterable[Any] = ()
    """The enumeration, for columns whose numbers stand for its members."""


COLUMNS: dict[str, ColumnSpec] = {
    "outcome": ColumnSpec("int8", "1", "how the rotation ends", Outcome),
    "omega_inf": ColumnSpec(
        "float64", "1/tau_0", "residual angular velocity along the dipole, signed"
    ),
    "omega_inf_error": ColumnSpec("float64", "1/tau_0", "estimated absolute error of omega_inf"),
    "time": ColumnSpec("float64", "tau_0", "time at which the outcome was certain"),
    "steps": ColumnSpec("int32", "1", "integration steps tried"),
    "certified": ColumnSpec(
        "bool", "1", "whether the region that ended the run is proven to decide for its level"
    ),
    "stop": ColumnSpec("int8", "1", "in which way a top stops", Stop),
    "regime": ColumnSpec("int8", "1", "law that decided", Regime),
    "probability": ColumnSpec("float64", "1", "probability that the rotation is residual"),
}
"""Columns of every basin."""

OPTIONAL_COLUMNS: dict[str, ColumnSpec] = {
    "changed": ColumnSpec("bool", "1", "whether the outcome differs at the second tolerance"),
    "computed": ColumnSpec("bool", "1", "whether the start was integrated, not filled in"),
    "counts": ColumnSpec("int64", "1", "how many starts, see the header"),
}
"""Columns of some basins, and the column of a tally."""

MISSING: dict[str, Any] = {
    "int8": -128,
    "int32": -(2**31),
    "int64": -1,
    "float64": nan,
    "bool": False,
}
"""Fill values for numbers that are not computed yet, by their type."""

DERIVATIVE_PREFIX = "d_omega_inf_d_"
"""A column of derivatives has this prefix and the name of the axis."""


VERSION = "version_"
"""The prefix of attributes with versions."""

LEVEL = "level"
"""The attribute with the label of the equation's level."""

START = "omega0"
"""The column of starts, in basins of samples."""

AXES: dict[str, tuple[str, str]] = {
    "delta": ("1", "1 - I3/I1"),
    "phi": ("rad", "azimuth of the angular velocity about axis 3"),
    "theta": ("rad", "polar angle of the angular velocity from axis 3"),
    "w_perp": ("1/tau_0", "angular velocity across axis 3"),
    **{f"w{k}": ("1/tau_0", f"angular velocity along axis {k}") for k in (1, 2, 3)},
    "amplitude": ("1/tau_0", "magnitude of the angular velocity"),
    START: ("1/tau_0", "angular velocity at the start, in body axes"),
}
"""Unit and meaning of arguments with a usual name; other arguments have neither."""


class BasinParts(NamedTuple):
    """The content of a basin as plain values, in the form that a store reads and writes."""

    dims: tuple[str, ...]
    shape: tuple[int, ...]
    coords: dict[str, Float[ndarray, "..."]]
    columns: Mapping[str, Any]
    attrs: dict[str, Any]


def is_result(column: str) -> bool:
    """Return whether a column holds results, rather than the starts or their parameters."""
    return column in COLUMNS | OPTIONAL_COLUMNS or column.startswith(DERIVATIVE_PREFIX)


def check_arguments(origin: str, names: Iterable[str]) -> None:
    """Refuse arguments of a problem that have the name of a column."""
    for name in names:
        if is_result(name):
            refuse(origin, "give no argument the name of a column of a basin", f"names `{name}`")


def column_spec(column: str) -> ColumnSpec:
    """Return type, unit and meaning of a column."""
    if column.startswith(DERIVATIVE_PREFIX):
        axis = column.removeprefix(DERIVATIVE_PREFIX)
        unit, meaning = f"1/tau_0 per unit of {axis}", f"derivative of omega_inf by {axis}"
        return ColumnSpec("float64", unit, meaning)
    if is_result(column):
        return (COLUMNS | OPTIONAL_COLUMNS)[column]
    return ColumnSpec("float64", *AXES.get(column, ("", "")))


def coordinate_dims(name: str, dims: tuple[str, ...], ndim: int) -> tuple[str, ...]:
    """Return the names of the axes of coordinates of a grid axis, of points or of one point."""
    if ndim == 0:
        return ()
    first = name if name in dims else dims[0]
    return (first, *component_dims(name, ndim - 1))


def component_dims(name: str, count: int) -> tuple[str, ...]:
    """Return the names of the component axes of vectors or arrays."""
    if name == START:
        return ("component",)[:count]
    return tuple(f"{name}_{k}" for k in range(1, 1 + count))


def plain_attributes(attrs: Mapping[str, Any]) -> dict[str, Any]:
    """Return the attributes in a form that every data format can hold; booleans become text."""
    plain = {key: str(x) if isinstance(x, bool) else x for key, x in attrs.items()}
    return {"Conventions": "CF-1.11"} | plain


def with_level(
    coords: Mapping[str, Any], attrs: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return coordinates and attributes for xarray, with the level as a coordinate.

    When xarray joins datasets it keeps the attributes of the first one, but all coordinates.
    """
    rest = plain_attributes({name: x for name, x in attrs.items() if name != LEVEL})
    return {LEVEL: ((), attrs[LEVEL]), **coords} if LEVEL in attrs else dict(coords), rest


def without_versions(attrs: Mapping[str, Any]) -> dict[str, Any]:
    """Return the attributes without the versions of libraries, which do not distinguish sweeps."""
    return {key: x for key, x in attrs.items() if not key.startswith(VERSION)}


def labels(name: str) -> dict[str, Any]:
    """Return the CF attributes of a column or an axis: unit, meaning and flags."""
    dtype, unit, meaning, members = column_spec(name)
    flags = {"no": 0, "yes": 1} if dtype == "bool" else {x.name: int(x) for x in members}
    texts = {"units": unit, "long_name": meaning} if meaning else {}
    if not flags:
        return texts
    return texts | {"flag_values": list(flags.values()), "flag_meanings": " ".join(flags)}
