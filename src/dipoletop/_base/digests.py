"""Digests: of bytes, of arrays, and of what a function computes, whatever it is called."""

import enum
import hashlib
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

SIZE = 16
"""Bytes of a digest."""
BESIDE = (
    *("name", "debug_info", "inline", "keep_unused", "donated_invars", "compiler_options_kvs"),
    *("sharding", "out_sharding", "in_shardings", "out_shardings", "in_layouts", "out_layouts"),
    "ctx_mesh",
)
"""Parameters of primitives that do not say what is computed, but how it is called or where."""


def digest(*parts: bytes) -> bytes:
    """A digest of byte strings, each with its length."""
    found = hashlib.sha256()
    for part in parts:
        found.update(len(part).to_bytes(8, "little"))
        found.update(part)
    return found.digest()[:SIZE]


def array_digest(*arrays: Any) -> bytes:
    """A digest of numbers, their types and shapes."""
    return digest(*(part for array in arrays for part in _parts(array)))


def _parts(array: Any) -> tuple[bytes, bytes]:
    if hasattr(array, "dtype") and jnp.issubdtype(array.dtype, jax.dtypes.prng_key):
        array = jax.random.key_data(array)
    numbers = np.asarray(array)
    return repr((numbers.dtype.str, numbers.shape)).encode(), numbers.tobytes()


def program_digest(function: Callable[..., Any], *arguments: Any) -> bytes:
    """A digest of the traced program of a function of arrays (or of their shapes).

    It holds primitives, shapes, types, parameters that are numbers or programs, and the bytes of
    constants; variables are numbered in the order in which they appear. There is nothing in it
    of names, addresses and source lines. What a callback to Python computes is not seen.
    """
    return _Canonical().closed(jax.make_jaxpr(function)(*arguments))


class _Canonical:
    """Programs within a program, each hashed once."""

    def __init__(self) -> None:
        # The programs are kept with their digests: an address could be used again.
        self._known: dict[int, tuple[Any, bytes]] = {}

    def closed(self, program: Any) -> bytes:
        return digest(self.plain(program.jaxpr), *(array_digest(c) for c in program.consts))

    def plain(self, program: Any) -> bytes:
        if id(program) not in self._known:
            self._known[id(program)] = program, self._program(program)
        return self._known[id(program)][1]

    def _program(self, program: Any) -> bytes:
        numbers: dict[Any, int] = {}

        def said(atom: Any) -> bytes:
            kind, shape = getattr(atom.aval, "dtype", None), getattr(atom.aval, "shape", None)
            if isinstance(atom, Literal):
                # 0, 0.0 and np.float64(0) may all stand for the same literal.
                return b"literal " + array_digest(np.asarray(atom.val, kind))
            return f"{numbers.setdefault(atom, len(numbers))} {kind} {shape}".encode()

        parts = [said(atom) for atom in (*program.constvars, *program.invars)]
        for equation in program.eqns:
            parts += [str(equation.primitive).encode(), *(said(atom) for atom in equation.invars)]
            parts += [said(atom) for atom in equation.outvars]
            for name in sorted(set(equation.params) - set(BESIDE)):
                parts += [name.encode(), self.value(equation.params[name])]
        return digest(*parts, *(said(atom) for atom in program.outvars))

    def value(self, value: Any) -> bytes:
        """A parameter: a number, a text, a program, or a collection of such; else nothing."""
        if isinstance(value, ClosedJaxpr):
            return self.closed(value)
        if isinstance(value, Jaxpr):
            return self.plain(value)
        if isinstance(value, enum.Enum):
            return value.name.encode()
        if isinstance(value, np.dtype):  # one type has several forms, dtype("<f8") among them
            return str(value).encode()
        if value is None or isinstance(value, bool | str | bytes):
            return repr(value).encode()
        if isinstance(value, int | np.integer):  # 3 and np.int64(3) are the same length
            return repr(int(value)).encode()
        if isinstance(value, float | complex | np.generic | np.ndarray | jax.Array):
            return array_digest(value)
        if isinstance(value, dict):
            return digest(*(self.value(item) for item in sorted(value.items(), key=repr)))
        if isinstance(value, set | frozenset):
            return digest(*sorted(self.value(item) for item in value))
        if isinstance(value, tuple | list):
            return digest(*(self.value(item) for item in value))
        return b""
