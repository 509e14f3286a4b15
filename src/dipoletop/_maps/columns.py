"""The schema of a basin: its columns and customary axes, with types, units and meanings."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from jaxtyping import Float
from numpy import ndarray


class ColumnSpec(NamedTuple):
    """Type of the numbers of a column, their unit, and what they mean."""

    dtype: str
    unit: str
    meaning: str


COLUMNS: dict[str, ColumnSpec] = {
    "outcome": ColumnSpec("int8", "1", "FAILED -1, UNDECIDED 0, RESIDUAL 1, STOP 2"),
    "omega_inf": ColumnSpec(
        "float64", "1/tau_0", "residual angular velocity along the dipole, signed"
    ),
    "omega_inf_error": ColumnSpec("float64", "1/tau_0", "estimated absolute error of omega_inf"),
    "time": ColumnSpec("float64", "tau_0", "time at which the outcome was certain"),
    "steps": ColumnSpec("int32", "1", "integration steps tried"),
    "certified": ColumnSpec(
        "bool", "1", "whether the region that ended the run is proven to decide for its level"
    ),
    "stop": ColumnSpec("int8", "1", "NONE 0, AXIS 1, ROTATING 2, WOBBLING 3, TUMBLING 4"),
}
"""Columns of every basin."""

SLOW_COLUMNS: dict[str, ColumnSpec] = {
    "regime": ColumnSpec(
        "int8", "1", "law that decided: RESOLVED 0, SLOW_FLOW 1, AVERAGED 2, UNFOLDED 3, EXACT 4"
    ),
    "probability": ColumnSpec("float64", "1", "probability that the rotation is residual"),
}
"""Columns of basins whose slow runs may be predicted; see `columns_of_runs`."""

OPTIONAL_COLUMNS: dict[str, ColumnSpec] = {
    "changed": ColumnSpec("bool", "1", "whether the outcome differs at the second tolerance"),
    "computed": ColumnSpec("bool", "1", "whether the start was integrated, not filled in"),
}
"""Columns of some basins."""

DERIVATIVE_PREFIX = "d_omega_inf_d_"
"""A column of derivatives has this prefix and the name of the axis."""

AXES: dict[str, tuple[str, str]] = {
    "delta": ("1", "1 - I3/I1"),
    "phi": ("rad", "azimuth of the angular velocity about axis 3"),
    "theta": ("rad", "polar angle of the angular velocity from axis 3"),
    "w_perp": ("1/tau_0", "angular velocity across axis 3"),
    **{f"w{k}": ("1/tau_0", f"angular velocity along axis {k}") for k in (1, 2, 3)},
    "amplitude": ("1/tau_0", "magnitude of the angular velocity"),
}
"""Unit and meaning of axes with a customary name; other axes have neither."""


class BasinParts(NamedTuple):
    """All that a basin consists of, as plain values: what a store takes and gives."""

    dims: tuple[str, ...]
    shape: tuple[int, ...]
    coords: dict[str, Float[ndarray, "..."]]
    columns: Mapping[str, Any]
    attrs: dict[str, Any]


def columns_of_runs(slow_flow: bool | str) -> dict[str, ColumnSpec]:
    """The columns of runs that are predicted where they are slow, or are not."""
    return COLUMNS if slow_flow is False else COLUMNS | SLOW_COLUMNS


def column_spec(column: str) -> ColumnSpec:
    """Type, unit and meaning of a column."""
    if column.startswith(DERIVATIVE_PREFIX):
        axis = column.removeprefix(DERIVATIVE_PREFIX)
        unit, meaning = f"1/tau_0 per unit of {axis}", f"derivative of omega_inf by {axis}"
        return ColumnSpec("float64", unit, meaning)
    return (COLUMNS | SLOW_COLUMNS | OPTIONAL_COLUMNS)[column]
