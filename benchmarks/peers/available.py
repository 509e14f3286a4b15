"""The peers that can run here.

A peer is `run(deltas, omegas, rtol) -> dict`: `labels` (integers of dipoletop.Outcome), both clocks
of `measure` (the processor's is steadier where others work too), `compile_seconds`, `steps` (lane
steps made). A peer that is not installed is left out, with a line that says so. float64 must be on
in jax before a jax peer runs, and heyoka starts processes: call from under a `__main__` guard.
"""

import importlib
from collections.abc import Callable
from functools import partial
from typing import Any

from benchmarks.peers import with_diffrax
from benchmarks.reporting.views import HEYOKA

Peer = Callable[..., dict[str, Any]]


def available() -> tuple[dict[str, Peer], list[str]]:
    """Return the peers that can run here by name, and one line for each that cannot."""
    peers: dict[str, Peer] = {}
    missing = []
    try:
        peers[HEYOKA] = importlib.import_module("benchmarks.peers.with_heyoka").run
    except ImportError as error:
        missing.append(f"{HEYOKA}: left out ({error})")
    for way in ("repacked", "chunked", "whole"):
        peers[f"diffrax vmap {way}, tuple"] = partial(with_diffrax.run, way=way)
    peers["diffrax vmap whole, (3,)"] = partial(with_diffrax.run, as_tuple=False, way="whole")
    return peers, missing
