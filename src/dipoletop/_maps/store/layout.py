"""The layout of a store on disk, and the creation of an empty one.

A store is a Zarr group that xarray opens: columns in the shape of the grid, one chunk for each
tile, and coordinates. A group inside it, which xarray ignores, keeps the sweep's header and one
record for each finished tile.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..._base.digests import SIZE, digest
from ..columns import (
    MISSING,
    column_spec,
    component_dims,
    coordinate_dims,
    labels,
    plain_attributes,
)
from ..tiling import Tiling
from .arrays import METADATA, StoredArray, content_of, write_json
from .headers import Header, header_digest

FORMAT = "dipoletop basin, version 3"
LARGEST_CHUNK = 1 << 20  # numbers of coordinates; codecs take no more than 2 GiB at once

GROUP = "dipoletop-tiles"
"""The group whose attributes are the header."""
RECORDS = f"{GROUP}/done"
CLAIMS = f"{GROUP}/claims"
STAGING = f"{GROUP}/partial"


def create_arrays(folder: Path, header: Header, values: Mapping[str, np.ndarray]) -> None:
    """Create an empty store: metadata and the swept values, but no tile."""
    names, drawn = header["columns"], header["drawn"]
    dims = tuple(header.get("tally", header)["dims"])
    arrays = {name: _column(folder / name, header) for name in names}
    for name, array in values.items():
        arrays[name] = _coordinates(folder / name, array, dims)
    shown = {name: array.metadata for name, array in arrays.items()}
    shape = tiling_of(header).count, SIZE * (3 + len(names))
    records, numbers = folder / RECORDS, np.dtype("uint8")
    # Not packed, since a record contains its own checksum.
    arrays[RECORDS] = StoredArray(records, shape, (1, shape[1]), numbers, packed=False)
    for array in arrays.values():
        array.create()
    for name, swept in values.items():
        arrays[name].write_all(swept)
    (folder / CLAIMS).touch()
    others = [name for name in (*values, *drawn) if name not in dims]
    attributes = {
        **plain_attributes(header["attrs"]),
        **({"problem_digest": header["programs"]["problem"]} if "programs" in header else {}),
        **({"coordinates": " ".join(others)} if others else {}),
    }
    # Without these metadata xarray warns that it opens many small files.
    consolidated = {"kind": "inline", "must_understand": False, "metadata": shown}
    write_json(folder / METADATA, _group(attributes) | {"consolidated_metadata": consolidated})
    layout = {name: metadata_digest(folder, name) for name in ("", *arrays)}
    full = {"format": FORMAT, "layout": layout, **header}
    own = {**full, "digest": header_digest(full)}
    write_json(folder / GROUP / METADATA, _group(own))  # its folder holds the records


def _column(folder: Path, header: Header) -> StoredArray:
    """Return the array of a column, in the shape of the grid, with component axes last."""
    name, tiling, dims = folder.name, tiling_of(header), tuple(header["dims"])
    dtype = column_spec(name).dtype
    components = tuple((header["drawn"] | header.get("components", {})).get(name, ()))
    kept = "int8" if dtype == "bool" else dtype  # has a fill value for "missing"
    missing = {} if kept == "float64" else {"_FillValue": MISSING[kept]}
    return StoredArray(
        folder,
        (*tiling.shape, *components),
        (*tiling.chunk, *components),
        np.dtype(kept),
        fill=MISSING[kept],
        dims=(*dims, *component_dims(name, len(components))),
        attributes=labels(name) | missing,
    )


def _coordinates(folder: Path, values: np.ndarray, dims: tuple[str, ...]) -> StoredArray:
    """Return the array of the values on an axis, or of points."""
    return StoredArray(
        folder,
        values.shape,
        Tiling.of(values.shape, LARGEST_CHUNK).chunk,
        values.dtype,
        fill=MISSING["float64"],
        dims=coordinate_dims(folder.name, dims, values.ndim),
        attributes=labels(folder.name),
    )


def _group(attributes: dict[str, Any]) -> dict[str, Any]:
    return {"attributes": attributes, "zarr_format": 3, "node_type": "group"}


def tiling_of(header: Header) -> Tiling:
    """Return the tiling of the columns of a store."""
    return Tiling(tuple(header["shape"]), tuple(header["chunk"]))


def tiling_of_starts(header: Header) -> Tiling:
    """Return the tiling of the starts of the sweep, which for a tally differs from the columns'."""
    return tiling_of(header.get("tally", header))


def metadata_digest(folder: Path, array: str) -> str:
    """Return the digest of the metadata of an array, or of the store itself ("")."""
    return digest(content_of(folder / array / METADATA)).hex()
