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
NOT_COMPUTED = (
    *("name", "debug_info", "inline", "keep_unused", "donated_invars", "compiler_options_kvs"),
    *("sharding", "out_sharding", "in_shardings", "out_shardings", "in_layouts", "out_layouts"),
    "ctx_mesh",
)
"""Parameters of primitives that change no number: names, and where and how a call is run."""
OTHER_PROGRAMS = (
    *("call", "jvp_jaxpr_fun", "jvp_jaxpr_thunk", "fwd_jaxpr_thunk", "bwd", "out_trees"),
    *("prevent_cse", "policy"),
)
"""Parameters of calls that tell how they are differentiated; no value depends on them."""


def digest(*parts: bytes) -> bytes:
    """Digest of byte strings, each with its length."""
    sha = hashlib.sha256()
    for part in parts:
        sha.update(len(part).to_bytes(8, "little"))
        sha.update(part)
    return sha.digest()[:SIZE]


def array_digest(*arrays: Any) -> bytes:
    """Digest of numbers, their types and shapes."""
    return digest(*(part for array in arrays for part in _parts(array)))


def _parts(array: Any) -> tuple[bytes, bytes]:
    if hasattr(array, "dtype") and jnp.issubdtype(array.dtype, jax.dtypes.prng_key):
        array = jax.random.key_data(array)
    numbers = np.asarray(array)
    return repr((numbers.dtype.str, numbers.shape)).encode(), numbers.tobytes()


def program_digest(function: Callable[..., Any], *arguments: Any) -> bytes:
    """Digest of the traced program of a function of arrays (or of their shapes).

    It covers primitives, shapes, types, parameters that are numbers or programs, and the bytes of
    constants; variables are numbered in the order in which they appear. It does not depend on
    names, addresses and source lines. It cannot see what a callback to Python computes.
    """
    return _ProgramDigests().of_closed(jax.make_jaxpr(function)(*arguments))


def complete_digest(program: ClosedJaxpr) -> bytes | None:
    """Digest of a traced program; None if a parameter is of a kind that digests leave out."""
    digests = _ProgramDigests()
    known = digests.of_closed(program)
    return known if digests.complete else None


class _ProgramDigests:
    """Digests of a program and of the programs in it, each hashed once."""

    def __init__(self) -> None:
        # The programs are kept with their digests, so that no address (the key) is used again.
        self._known: dict[int, tuple[Any, bytes]] = {}
        self.complete = True
        """Whether every parameter that may change a number is part of the digests."""

    def of_closed(self, program: ClosedJaxpr) -> bytes:
        return digest(self.of_open(program.jaxpr), *(array_digest(c) for c in program.consts))

    def of_open(self, program: Jaxpr) -> bytes:
        if id(program) not in self._known:
            self._known[id(program)] = program, self._hashed(program)
        return self._known[id(program)][1]

    def _hashed(self, program: Jaxpr) -> bytes:
        numbers: dict[Any, int] = {}

        def of_atom(atom: Any) -> bytes:
            kind, shape = getattr(atom.aval, "dtype", None), getattr(atom.aval, "shape", None)
            if isinstance(atom, Literal):
                # 0, 0.0 and np.float64(0) may all stand for the same literal.
                return b"literal " + array_digest(np.asarray(atom.val, kind))
            return f"{numbers.setdefault(atom, len(numbers))} {kind} {shape}".encode()

        parts = [of_atom(atom) for atom in (*program.constvars, *program.invars)]
        for call in program.eqns:
            parts.append(str(call.primitive).encode())
            parts += [of_atom(atom) for atom in (*call.invars, *call.outvars)]
            for name in sorted(set(call.params) - set(NOT_COMPUTED)):
                complete = self.complete
                parts += [name.encode(), self._of_parameter(call.params[name])]
                if name in OTHER_PROGRAMS:
                    self.complete = complete
        return digest(*parts, *(of_atom(atom) for atom in program.outvars))

    def _of_parameter(self, value: Any) -> bytes:
        """Digest of a number, a text, a program, or a collection of such; else nothing."""
        if isinstance(value, ClosedJaxpr):
            return self.of_closed(value)
        if isinstance(value, Jaxpr):
            return self.of_open(value)
        if isinstance(value, enum.Enum):
            return value.name.encode()
        if isinstance(value, np.dtype):  # one type has several forms, such as dtype("<f8")
            return str(value).encode()
        if value is None or isinstance(value, bool | str | bytes):
            return repr(value).encode()
        if isinstance(value, int | np.integer):  # 3 and np.int64(3) are the same length
            return repr(int(value)).encode()
        if isinstance(value, float | complex | np.generic | np.ndarray | jax.Array):
            return array_digest(value)
        if isinstance(value, dict):
            return digest(*(self._of_parameter(item) for item in sorted(value.items(), key=repr)))
        if isinstance(value, set | frozenset):
            return digest(*sorted(self._of_parameter(item) for item in value))
        if isinstance(value, tuple | list):
            return digest(*(self._of_parameter(item) for item in value))
        self.complete = False
        return b""
