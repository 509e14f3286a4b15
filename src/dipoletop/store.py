"""Basins on disk: a Zarr group of flat columns, one chunk for each tile of a sweep.

Zarr writes each chunk to a temporary name and renames it. A tile's flag is set after its
columns, so a tile torn by a crash is simply not finished, and is computed again to the same
bytes.
"""

import contextlib
import json
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ._checks import refuse
from .basin import Basin, kind_of

Group = Any  # of zarr, whose item types are too wide to be of use
FORMAT = "dipoletop basin, version 1"


def create(path: Any, header: dict[str, Any], coords: dict[str, np.ndarray]) -> Group:
    """A new store, or the one at `path` if it belongs to the same sweep.

    `header` holds dims, shape, tile (starts in a chunk), columns (their names), attrs, and a
    fingerprint of the problem.
    """
    import zarr

    place = Path(os.fspath(path))
    if place.exists():
        group = _open(place, "store", "r+")
        for key, value in json.loads(json.dumps(header)).items():
            if _lasting(group.attrs.get(key)) != _lasting(value):
                refuse(
                    "store",
                    "be new or hold this very sweep",
                    f"{place} holds another one: its {key} differs",
                )
        return group
    with _whole(place) as fresh:
        _lay_out(fresh, header, coords)
    return zarr.open_group(place, mode="r+")


def _lasting(value: Any) -> Any:
    """What must agree for a sweep to go on: versions may change."""
    if not isinstance(value, dict):
        return value
    return {k: v for k, v in value.items() if not k.startswith("version_")}


@contextlib.contextmanager
def _whole(place: Path) -> Iterator[Path]:
    """A folder that gets its name when it is complete, so that a store is there whole or not."""
    place.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{place.name}-", dir=place.parent) as folder:
        fresh = Path(folder) / place.name
        yield fresh
        os.replace(fresh, place)


def _lay_out(place: Path, header: dict[str, Any], coords: dict[str, np.ndarray]) -> Group:
    import zarr

    group = zarr.open_group(place, mode="w")
    size = int(np.prod(header["shape"]))
    for name in header["columns"]:
        group.create_array(
            name,
            shape=(size,),
            chunks=(header["tile"],),
            dtype=kind_of(name)[0],
        )
    for name, values in coords.items():
        group.create_array(f"axis_{name}", data=values, chunks=values.shape)
    tiles = -(-size // header["tile"])
    group.create_array("done", shape=(tiles,), chunks=(1,), dtype="uint8")
    group.attrs.update({"format": FORMAT, "axes": list(coords)} | header)
    return group


def write_tile(group: Group, tile: int, columns: dict[str, np.ndarray]) -> None:
    """Write one tile, then its flag."""
    import zarr

    start = tile * group.attrs["tile"]
    # Chunks of nothing but zeros are written too: one that lacks is a damage.
    with zarr.config.set({"array.write_empty_chunks": True}):
        for name, values in columns.items():
            group[name][start : start + len(values)] = values
    group["done"][tile] = 1


def unfinished(group: Group) -> list[int]:
    """The tiles that have to be computed."""
    return np.flatnonzero(np.asarray(group["done"][:]) == 0).tolist()


def save(basin: Basin, path: Any) -> None:
    """Write a basin as one tile."""
    if Path(os.fspath(path)).exists():
        refuse("path", "not exist yet", f"{path} does")
    header = {
        "dims": list(basin.dims),
        "shape": list(basin.shape),
        "tile": int(np.prod(basin.shape)),
        "columns": list(basin.columns),
        "attrs": basin.attrs,
        "fingerprint": "",
    }
    columns = {name: basin.column(name).reshape(-1) for name in basin.columns}
    with _whole(Path(os.fspath(path))) as fresh:
        write_tile(_lay_out(fresh, header, basin.coords), 0, columns)


def load(path: Any) -> Basin:
    """The basin at `path`; see `Basin.load`."""
    group = _open(Path(os.fspath(path)), "path", "r")
    try:
        left, tiles = len(unfinished(group)), group["done"].shape[0]
        basin = view(group)
        if not left:
            for name in basin.columns:
                basin.column(name)
                if group[name].nchunks_initialized != tiles:
                    raise ValueError(f"chunks of {name} are missing")
    except Exception as error:
        refuse("path", "hold an undamaged basin", f"{path} cannot be read ({error})")
    if left:
        refuse(
            "path",
            "hold a finished sweep",
            f"{path} lacks {left} of {tiles} tiles; run the sweep again with this store",
        )
    return basin


def view(group: Group, seconds: float = np.nan) -> Basin:
    """The basin in a store, read from disk column by column when asked."""
    header: Any = dict(group.attrs)
    coords = {name: np.asarray(group[f"axis_{name}"][:]) for name in header["axes"]}
    columns = {name: group[name] for name in header["columns"]}
    dims, shape = tuple(header["dims"]), tuple(header["shape"])
    return Basin(dims, shape, coords, columns, dict(header["attrs"]), seconds)


def _open(place: Path, argument: str, mode: Any) -> Group:
    import zarr

    if not place.exists():
        refuse(argument, "be a folder with a basin", f"{place} does not exist")
    try:
        group = zarr.open_group(place, mode=mode)
        found = group.attrs.get("format")
    except Exception as error:
        refuse(argument, "be a folder with a basin", f"{place} cannot be read as one ({error})")
    if found != FORMAT:
        refuse(argument, f"be a {FORMAT}", f"the format of {place} is {found!r}")
    return group
