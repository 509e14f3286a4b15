"""Digests of bytes, of arrays, and of the computation of a function, whatever its name."""

import hashlib
import re
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

SIZE = 16
"""Length of a digest in bytes."""
_NAME = re.compile(r'@(?:"[^"]*"|[\w.$-]+)')
"""Pattern of names of functions in the text of a program."""
_PLACE = re.compile(r'jax\.result_info = "[^"]*"|backend_config = "?\d+"?')
"""Pattern of names of results and addresses of callbacks."""


def digest(*parts: bytes) -> bytes:
    """Return the digest of byte strings and their lengths."""
    sha = hashlib.sha256()
    for part in parts:
        sha.update(len(part).to_bytes(8, "little"))
        sha.update(part)
    return sha.digest()[:SIZE]


def array_digest(*arrays: Any) -> bytes:
    """Return the digest of numbers, their types and shapes."""
    return digest(*(part for array in arrays for part in _parts(array)))


def _parts(array: Any) -> tuple[bytes, bytes]:
    if hasattr(array, "dtype") and jnp.issubdtype(array.dtype, jax.dtypes.prng_key):
        array = jax.random.key_data(array)
    numbers = np.asarray(array)
    return repr((numbers.dtype.str, numbers.shape)).encode(), numbers.tobytes()


def program_digest(function: Callable[..., Any], *arguments: Any) -> bytes:
    """Return the digest of the computation of a function of arrays, or of shapes and types.

    It is the digest of the text into which JAX translates the traced program, without names. It
    covers operations, shapes, types and constants, but not the code of callbacks to Python.
    Other versions of JAX may give another translation.
    """
    lowered = jax.jit(lambda *given: function(*given)).lower(*arguments)
    numbers: dict[str, int] = {}

    def number(name: re.Match[str]) -> str:
        return f"@{numbers.setdefault(name[0], len(numbers))}"

    return digest(_NAME.sub(number, _PLACE.sub("", lowered.as_text())).encode())
