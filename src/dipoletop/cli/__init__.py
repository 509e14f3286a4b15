"""The command line: `dipoletop map`, `simulate`, `figures`, `spectrum`, `validate`, `store`."""

from .commands import main

__all__ = ["main"]
