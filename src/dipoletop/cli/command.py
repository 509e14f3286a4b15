"""What every command does: float64 is on before it computes, and a refusal is one line."""

import functools
from collections.abc import Callable
from typing import Any

import click

Command = Callable[..., None]


class Refusal(click.ClickException):
    """One line, and the exit status of a command that cannot be."""

    exit_code = 2


def computing(run: Command) -> Command:
    """float64 is on before anything is computed; a refusal is one line, and status 2."""

    @functools.wraps(run)
    def wrapped(**options: Any) -> None:
        import jax
        import matplotlib

        jax.config.update("jax_enable_x64", True)
        matplotlib.use("Agg")
        try:
            run(**options)
        except (ValueError, OSError) as error:
            raise Refusal(str(error)) from None

    return wrapped
