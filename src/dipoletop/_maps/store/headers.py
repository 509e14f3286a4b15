"""Headers of stores: their digests, which sweep they belong to, and how two of them differ.

A header is a dict that JSON can hold: dims, shape, chunk (lengths of a tile), columns (their
names), drawn (those that tell what the starts were, with their shapes), axes (their names), attrs,
digests of the swept values, and digests of the traced programs. A tally has one row of counts for
each tile; its header tells the shape of a row (components) and what is counted (tally).
"""

import json
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from ..._base.digests import array_digest, digest
from ..columns import without_versions

Header = dict[str, Any]


def with_value_digests(header: Header, values: Mapping[str, np.ndarray]) -> Header:
    """The header as JSON reads it back, with digests of the swept values."""
    digests = {name: array_digest(x).hex() for name, x in values.items()}
    return json.loads(json.dumps({**header, "values": digests}))


def header_digest(header: Header) -> str:
    """Digest of a header without its own `digest`."""
    return digest(json.dumps(header, sort_keys=True).encode()).hex()


def sweep_digest(header: Header) -> bytes:
    """Digest of all that tells one sweep from another; tile records carry it."""
    own = {key: x for key, x in _comparable(header).items() if key not in ("format", "layout")}
    return bytes.fromhex(header_digest(own))


def _comparable(header: Header) -> Header:
    """The header without versions: a sweep may be resumed by another version."""
    return {**header, "attrs": without_versions(header["attrs"])}


def differences(old: Header, new: Header, of_values: Callable[[str], str]) -> str:
    """Each setting that differs, with its value in both headers; empty if none does.

    `of_values` tells how the swept values of that name differ.
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
    """(keys from the outermost dict inwards, value) of a nested dict."""
    for key, value in header.items():
        if isinstance(value, dict):
            yield from _flat(value, (*group, key))
        else:
            yield (*group, key), value


def _jax_versions(old: Header, new: Header) -> str:
    """A remark if programs differ: another JAX may have traced the same function."""
    was, now = (header["attrs"].get("version_jax") for header in (old, new))
    if was == now or old.get("programs") == new.get("programs"):
        return ""
    return f" (JAX {was} traced it there and JAX {now} here, which may differ by that alone)"


def first_difference(name: str, there: np.ndarray, here: np.ndarray) -> str:
    """The first bits in which two arrays of swept values differ."""
    if there.shape != here.shape or there.dtype != here.dtype:
        was, now = (f"{x.dtype} of shape {x.shape}" for x in (there, here))
        return f"{name} is {was} there and {now} here"
    old_bits, new_bits = (np.ascontiguousarray(x).view(f"u{x.itemsize}") for x in (there, here))
    differs = np.any((old_bits != new_bits).reshape(len(there), -1), axis=1)
    first = int(np.argmax(differs))
    values = f"is {there[first].tolist()} there and {here[first].tolist()} here"
    return f"{name}[{first}] {values} ({np.sum(differs)} of {len(differs)} differ)"
