"""Parts of basins, by the positions or the values on their axes."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from .._base.checks import refuse
from .columns import BasinParts

Positions = dict[str, Any]
"""The wanted positions on some axes: a number, a slice, or an integer or boolean array."""


def at_positions(parts: BasinParts, positions: Mapping[str, Any]) -> BasinParts:
    """Return the part at these positions; an axis with a single position becomes a coordinate."""
    _check_dims(parts, positions)
    chosen = {
        dim: _chosen(dim, size, positions.get(dim, slice(None)))
        for dim, size in zip(parts.dims, parts.shape, strict=True)
    }
    every = np.ix_(*(np.atleast_1d(x) for x in chosen.values())) if chosen else ()
    flat = np.ravel_multi_index(every, parts.shape).ravel() if chosen else np.zeros(1, int)
    dims = tuple(dim for dim, x in chosen.items() if x.ndim)
    shape = tuple(len(chosen[dim]) for dim in dims)
    coords = {
        name: np.asarray(values[chosen[dim]]) if (dim := _dim_of(name, parts)) else values
        for name, values in parts.coords.items()
    }
    columns = {name: column.take(flat, axis=0) for name, column in parts.columns.items()}
    return BasinParts(dims, shape, coords, columns, parts.attrs)


def positions_of(parts: BasinParts, values: Mapping[str, Any], method: str | None) -> Positions:
    """Return the positions of values on axes, as `xarray.Dataset.sel` finds them."""
    import xarray

    _check_dims(parts, values)
    sizes, positions = dict(zip(parts.dims, parts.shape, strict=True)), {}
    for name, wanted in values.items():
        on_axis = parts.coords.get(name)
        if on_axis is not None and on_axis.ndim > 1:
            refuse(name, "be an axis of numbers (`isel` takes positions)", "is one of vectors")
        coords = {} if on_axis is None else {name: on_axis}
        every = xarray.DataArray(np.arange(sizes[name]), coords, (name,))
        is_range = isinstance(wanted, slice) or on_axis is None  # no `method` applies to these
        try:
            found = every.sel({name: wanted}, method=None if is_range else method)
        except (KeyError, IndexError, TypeError, ValueError) as error:
            must = "be values on that axis (`method='nearest'` takes the nearest ones)"
            refuse(name, must, f"is {wanted!r} ({' '.join(str(error).split())})")
        positions[name] = found.values
    return positions


def _check_dims(parts: BasinParts, by_name: Mapping[str, Any]) -> None:
    for name in by_name:
        if name not in parts.dims:
            refuse(name, f"be an axis of this basin ({', '.join(parts.dims) or 'none'})", "is not")


def _chosen(dim: str, size: int, positions: Any) -> np.ndarray:
    """Return the positions on an axis as an array; of rank 0 for a single position."""
    try:
        chosen = np.asarray(np.arange(size)[positions])
    except (IndexError, TypeError, ValueError) as error:
        refuse(dim, f"be positions from 0 to {size - 1}, or a slice", f"is {positions!r} ({error})")
    if chosen.ndim > 1 or chosen.size == 0:
        refuse(dim, "choose at least one position, along one axis", f"is {positions!r}")
    return chosen


def _dim_of(name: str, parts: BasinParts) -> str | None:
    """Return the axis along which coordinates vary; None for a single point."""
    if name in parts.dims:
        return name
    listed = parts.dims[:1] == ("point",) and parts.coords[name].ndim > 0
    return parts.dims[0] if listed and len(parts.coords[name]) == parts.shape[0] else None
