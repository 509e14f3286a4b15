"""Parts of basins, by the positions or the values on their axes."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from .._base.refusals import refuse
from .columns import BasinParts, is_result

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
        ends = (wanted.start, wanted.stop) if isinstance(wanted, slice) else wanted
        if np.iscomplexobj(ends):  # xarray would drop the imaginary part
            refuse(name, "be real values on that axis", f"is {wanted!r}")
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


def places_of(parts: BasinParts, like: BasinParts) -> np.ndarray:
    """Return the flat places, in one basin, of all starts of another one, in its order.

    Raises:
        ValueError: they have other axes, other values on them, or other starts.
    """
    if sorted(parts.dims) != sorted(like.dims):
        refuse("other", f"have the axes {', '.join(like.dims)}", f"has {', '.join(parts.dims)}")
    on_axes = [_places_on_axis(dim, parts, like) for dim in parts.dims]
    flat = np.ravel_multi_index(np.ix_(*on_axes), parts.shape) if on_axes else np.zeros((), int)
    return np.transpose(flat, [parts.dims.index(dim) for dim in like.dims]).ravel()


def _places_on_axis(dim: str, parts: BasinParts, like: BasinParts) -> np.ndarray:
    """Return the places on an axis of the values that another basin has there, in its order."""
    here, there = (_values_along(dim, each) for each in (parts, like))
    must = f"have the same values as this basin along the axis {dim}"
    if here.keys() != there.keys():
        refuse("other", must, f"has {', '.join(here) or 'none'}, not {', '.join(there) or 'none'}")
    sizes = [each.shape[each.dims.index(dim)] for each in (parts, like)]
    if sizes[0] != sizes[1]:
        refuse("other", must, f"has {sizes[0]}, not {sizes[1]}")
    if not here:
        return np.arange(sizes[0])
    tables = [
        np.column_stack([x.reshape(len(x), -1) for x in each.values()]) for each in (here, there)
    ]
    orders = [np.lexsort(table.T[::-1]) for table in tables]
    first, second = (table[order] for table, order in zip(tables, orders, strict=True))
    if not np.array_equal(first, second):
        refuse("other", must, f"has other values of {', '.join(here)}")
    places = np.empty_like(orders[0])
    places[orders[1]] = orders[0]
    return places


def _values_along(dim: str, parts: BasinParts) -> dict[str, np.ndarray]:
    """Return the coordinates along an axis; of a sample, its starts and their parameters."""
    named = {name: x for name, x in parts.coords.items() if _dim_of(name, parts) == dim}
    drawn = {name: x for name, x in parts.columns.items() if not is_result(name)}
    whole = named | (drawn if len(parts.dims) == 1 else {})
    return {name: np.asarray(whole[name]) for name in sorted(whole)}


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
