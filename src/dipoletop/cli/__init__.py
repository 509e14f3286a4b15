"""The command line: `dipoletop map`, `simulate`, `predict`, `atlas`, `figures`, …."""

from .commands import main

__all__ = ["main"]
