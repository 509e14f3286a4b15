"""Headers of stores: their digests, the sweeps they identify, and differences between them.

A header is a dict that JSON can hold: dims, shape, chunk (lengths of a tile), columns (names),
drawn (columns with starts and parameters, with their shapes), axes (names), attrs, digests of the
swept values, and digests of the traced programs. A tally has one row of counts for each tile; its
header has the shape of a row (components) and the meaning of the counts (tally).
"""

import json
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from ..._base.digests import array_digest, digest
from ..columns import without_versions

Header = dict[str, Any]


def with_value_digests(header: Header, values: Mapping[str, np.ndarray]) -> Header:
    """Return the header after a round trip through JSON, with digests of the swept values."""
    digests = {name: array_digest(x).hex() for name, x in values.items()}
    return json.loads(json.dumps({**header, "values": digests}))


def header_digest(header: Header) -> str:
    """Return the digest of a header without its own `digest`."""
    return digest(json.dumps(header, sort_keys=True).encode()).hex()


def sweep_digest(header: Header) -> bytes:
    """Return the digest that identifies a sweep; tile records contain it."""
    own = {key: x for key, x in _comparable(header).items() if key not in ("format", "layout")}
    return bytes.fromhex(header_digest(own))


def _comparable(header: Header) -> Header:
    """Return the header without versions: a sweep may be resumed by another version."""
    return {**header, "attrs": without_versions(header["attrs"])}


def differences(old: Header, new: Header, of_values: Callable[[str], str]) -> str:
    """Return the settings that differ, with their values in both headers; "" if they are equal.

    `of_values` is a function from the name of swept values to a description of their difference.
    """
    listed = ", ".join(_differences(old, new, of_values))
    return listed + _jax_versions(old, new) if listed else ""


def _differences(old: Header, new: Header, of_values: Callable[[str], str]) -> Iterator[str]:
    there, here = (dict(_flat(_comparable(header))) for header in (old, new))
    for key in {**there, **here}:
        was, now = there.get(key), here.get(key)
        if was == now or key[0] in ("format", "layout"):
            continue
        *group, name = key
        if group == ["values"] and was and now:
            yield of_values(name)
        elif group == ["programs"]:
            yield f"the program of `{name}` is {str(was)[:8]} there and {str(now)[:8]} here"
        else:
            yield f"{name} is {was} there and {now} here"


def _flat(header: Header, group: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield (keys from the outermost dict inwards, value) for each value of a nested dict."""
    for key, value in header.items():
        if isinstance(value, dict):
            yield from _flat(value, (*group, key))
        else:
            yield (*group, key), value


def _jax_versions(old: Header, new: Header) -> str:
    """Return a remark if JAX versions differ, which may explain different programs."""
    was, now = (header["attrs"].get("version_jax") for header in (old, new))
    if was == now or old.get("programs") == new.get("programs"):
        return ""
    return f" (JAX {was} traced it there and JAX {now} here, which alone may make a difference)"


def first_difference(name: str, there: np.ndarray, here: np.ndarray) -> str:
    """Return a description of the first difference between two arrays of swept values."""
    if there.shape != here.shape or there.dtype != here.dtype:
        was, now = (f"{x.dtype} of shape {x.shape}" for x in (there, here))
        return f"{name} is {was} there and {now} here"
    old_bits, new_bits = (np.ascontiguousarray(x).view(f"u{x.itemsize}") for x in (there, here))
    differs = np.any((old_bits != new_bits).reshape(len(there), -1), axis=1)
    first = int(np.argmax(differs))
    values = f"is {there[first].tolist()} there and {here[first].tolist()} here"
    return f"{name}[{first}] {values} ({np.sum(differs)} of {len(differs)} differ)"
