"""Digests: of bytes, of arrays, and of what a function computes, whatever it is called."""

import hashlib
import re
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

SIZE = 16
"""Bytes of a digest."""
_NAME = re.compile(r'@(?:"[^"]*"|[\w.$-]+)')
"""Names of functions in the text of a program."""
_PLACE = re.compile(r'jax\.result_info = "[^"]*"|backend_config = "?\d+"?')
"""Names of results, and addresses of callbacks."""


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
    """Digest of what a function of arrays computes (the arguments may be shapes and types).

    See `lowered_digest`.
    """
    return lowered_digest(jax.jit(lambda *given: function(*given)).lower(*arguments))


def lowered_digest(lowered: jax.stages.Lowered) -> bytes:
    """Digest of the text into which JAX translates a traced program, without names and places.

    It covers operations, shapes, types and constants, but not what a callback to Python computes.
    Other versions of JAX may translate otherwise.
    """
    numbers: dict[str, int] = {}

    def number(name: re.Match[str]) -> str:
        return f"@{numbers.setdefault(name[0], len(numbers))}"

    return digest(_NAME.sub(number, _PLACE.sub("", lowered.as_text())).encode())
