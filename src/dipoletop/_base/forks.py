"""Forked processes: they have none of JAX's threads, and would wait for them for ever."""

import os

_orphan = False


def _note() -> None:
    from jax._src import xla_bridge  # nothing public tells

    global _orphan
    _orphan = xla_bridge.backends_are_initialized()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_note)


def refuse_orphan() -> None:
    """Refuse to compute in a process that was forked from one in which JAX had computed."""
    if _orphan:
        raise RuntimeError(
            "A process that is forked once JAX has computed cannot compute, since JAX's threads "
            'stay behind: start it by multiprocessing.get_context("spawn") instead.'
        )
