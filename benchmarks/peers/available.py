"""The peers that can run here.

A peer is a function `run(deltas, omegas, rtol) -> dict` with `labels` (integers of
dipoletop.Outcome), `seconds` of wall time, `processor_seconds` (of all cores; steadier on a busy
machine), `compile_seconds`, `steps` (lane steps made), `note`. A peer that is not installed is left
out, with a line that says so. float64 must be on in jax before a jax peer runs, and heyoka starts
processes: call from under `if __name__ == "__main__"`.
"""

import importlib
from collections.abc import Callable
from functools import partial
from typing import Any

Peer = Callable[..., dict[str, Any]]


def available() -> tuple[dict[str, Peer], list[str]]:
    """Return the peers that can run here by name, and one line for each that cannot."""
    peers: dict[str, Peer] = {}
    missing = []
    try:
        peers["heyoka batch"] = importlib.import_module("benchmarks.peers.with_heyoka").run
    except ImportError as error:
        missing.append(f"heyoka batch: left out ({error})")
    try:
        diffrax = importlib.import_module("benchmarks.peers.with_diffrax").run
    except ImportError as error:
        missing.append(f"diffrax: left out ({error})")
    else:
        for way in ("repacked", "chunked", "whole"):
            peers[f"diffrax vmap {way}, tuple"] = partial(diffrax, as_tuple=True, way=way)
            peers[f"diffrax vmap {way}, (3,)"] = partial(diffrax, as_tuple=False, way=way)
    return peers, missing
