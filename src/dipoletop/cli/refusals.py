"""Errors that end a command with one line, and the float64 in which every command computes."""

import functools
from collections.abc import Callable
from typing import Any

import click
import jax

from .._maps.store.errors import StoreDamaged, StoreMismatch
from .terminals import forgiving_output

Command = Callable[..., None]


class Refusal(click.ClickException):
    """An error of one line, with exit status 2: the arguments or files do not allow the command."""

    exit_code = 2


def computing(command: Command) -> Command:
    """A command that computes in float64, draws to files, and reports a refusal in one line.

    A refusal is an argument that the library does not take, or a file or store that cannot be used.
    Any other error is one of the program, and keeps its traceback.
    """

    @functools.wraps(command)
    def wrapped(**options: Any) -> None:
        import matplotlib

        jax.config.update("jax_enable_x64", True)
        matplotlib.use("Agg")
        try:
            with forgiving_output():
                command(**options)
        except (StoreDamaged, StoreMismatch) as error:
            raise Refusal(str(error)) from None
        except OSError as error:
            raise Refusal(_sentence(error)) from None
        except ValueError as error:
            if not str(error).startswith("Argument `"):
                raise
            raise Refusal(str(error)) from None

    return wrapped


def _sentence(error: OSError) -> str:
    """What the system refused, without its number."""
    if error.strerror is None:
        return str(error)
    return f"{error.filename or 'A file'} cannot be used ({error.strerror.lower()})."
