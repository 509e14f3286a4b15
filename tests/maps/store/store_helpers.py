"""A sweep of two tiles for the tests of stores, and how its files are looked at and harmed."""

import numpy as np
import zarr

import dipoletop as dt
from dipoletop._maps.store.headers import header_digest

SIZE = 12, 18  # two tiles, the second not full
HEADER = "dipoletop-tiles/zarr.json"
RECORDS = "dipoletop-tiles/done"


GRID = dt.Grid(w3=np.linspace(0.0, 0.45, SIZE[0]), phi=np.linspace(0.0, 3.0, SIZE[1]))


KINDS = {
    "outcome": "int8",
    "omega_inf": "float64",
    "time": "float64",
    "steps": "int32",
    "certified": "bool",
    "stop": "int8",
}


def reduced(w3, phi, delta=-0.2):
    return dt.TransverseReduced(delta), dt.cylindrical(0.2, w3, phi)


def numbers(basin):
    """Every bit of a basin."""
    arrays = {name: basin.column(name) for name in basin.columns} | basin.coords
    return {name: (x.dtype, x.shape, x.tobytes()) for name, x in arrays.items()} | basin.attrs


def contents(good):
    """Paths of the files of a store that say anything."""
    every = (p for p in good.rglob("*") if p.is_file() and p.stat().st_size)
    return sorted(p.relative_to(good) for p in every)


def victims(good, kind):
    """The files of a store that hold columns, axes, records, metadata of these, or the header."""
    sorts = {"columns": [], "axes": [], "records": [], "metadata": [], "header": []}
    for path in contents(good):
        sort = "columns"
        if path.name == "zarr.json":
            sort = "header" if str(path) == HEADER else "metadata"
        elif path.parts[0] in GRID.axes:
            sort = "axes"
        elif str(path).startswith(RECORDS):
            sort = "records"
        sorts[sort].append(path)
    assert all(sorts.values())
    return sorts[kind]


def header_of(place):
    """The header of a store, with its digest."""
    return dict(zarr.open_group(place / "dipoletop-tiles", mode="r").attrs)


def rewrite(place, **changes):
    """Change a header as a program would that knows its digest."""
    header = header_of(place) | changes
    del header["digest"]
    header["digest"] = header_digest(header)
    zarr.open_group(place / "dipoletop-tiles", mode="r+").attrs.update(header)
