"""Decorators of commands: float64 and one-line errors, and the options of the quantities."""

import functools
from collections.abc import Callable
from typing import Any

import click

from .parameters import Number
from .quantities import QUANTITIES, as_text

Command = Callable[..., None]


class Refusal(click.ClickException):
    """An error of one line, with exit status 2: the arguments or files do not allow the command."""

    exit_code = 2


def computing(command: Command) -> Command:
    """A command that computes in float64, draws to files, and reports a refusal in one line."""

    @functools.wraps(command)
    def wrapped(**options: Any) -> None:
        import jax
        import matplotlib

        jax.config.update("jax_enable_x64", True)
        matplotlib.use("Agg")
        try:
            command(**options)
        except (ValueError, OSError) as error:
            raise Refusal(str(error)) from None

    return wrapped


def quantity_options(command: Command) -> Command:
    """The options --delta, --w-perp, …; the command gets them by the names of `QUANTITIES`."""
    for name, quantity in reversed(QUANTITIES.items()):
        default = as_text(quantity.default).replace("π", "pi")
        help_text = f"{quantity.meaning}  [default: {default}]"
        option = click.option(f"--{quantity.option}", name, type=Number(), help=help_text)
        command = option(command)
    return command
