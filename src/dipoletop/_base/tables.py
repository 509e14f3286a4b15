"""Tables of pandas from data of xarray."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas


def rows_of(data: Any, dims: tuple[str, ...]) -> "pandas.DataFrame":
    """Return a row for each place on the axes `dims`; components have columns of their own.

    Args:
        data: an `xarray.Dataset`.
        dims: the axes.

    The units of the columns are in `attrs["units"]` of the table.
    """
    columns = []
    for name in [*data.coords, *data.data_vars]:
        behind = [dim for dim in data[name].dims if dim not in dims]
        parts = {}
        if behind:
            values, attrs = data[name].values, data[name].attrs
            kept = data[name].dims[: -len(behind)]
            flat = values.reshape(*values.shape[: len(kept)], -1)
            parts = {f"{name}_{k + 1}": (kept, flat[..., k], attrs) for k in range(flat.shape[-1])}
            data = data.drop_vars(name).assign(parts)
        columns += list(parts) or [name]
    table = data.to_dataframe().reset_index()
    table = table[[*(name for name in table if name not in columns), *columns]]
    units = {str(name): data[name].attrs.get("units") for name in data.variables}
    table.attrs["units"] = {name: unit for name, unit in units.items() if unit is not None}
    return table
