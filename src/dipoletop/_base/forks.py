"""Refusal to compute in a forked process.

A fork copies only the thread that calls it. JAX's own threads are missing in the child, which would
wait for them for ever: https://docs.python.org/3/library/os.html#os.fork.
"""

import os

_orphan = False


def _after_fork() -> None:
    from jax._src import xla_bridge  # no public function says whether JAX has computed

    global _orphan
    _orphan = xla_bridge.backends_are_initialized()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


def refuse_orphan() -> None:
    """Refuse to compute in a process forked from one in which JAX had already computed."""
    if _orphan:
        raise RuntimeError(
            "A process that is forked once JAX has computed cannot compute, since JAX's threads "
            'stay behind: start it by multiprocessing.get_context("spawn") instead.'
        )
