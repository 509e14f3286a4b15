"""How every command runs and ends: in float64, with one line for an error, or stopped."""

import contextlib
import functools
import io
import os
import re
import shlex
import signal
import sys
from collections.abc import Callable, Iterator
from typing import Any

import click

from .._maps.store.errors import StoreDamaged

Command = Callable[..., None]
OPTIONS = {"client": "--scheduler", "store": "--output"}
"""Options whose values have another name in the library."""
NAMES = "SIGINT", "SIGTERM", "SIGHUP"
SIGNALS = [getattr(signal, name) for name in NAMES if hasattr(signal, name)]
TIME_IS_UP = 124  # exit status, as of `timeout`
_status: list[int] = []  # the exit status of the first signal


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
        import jax
        import matplotlib

        jax.config.update("jax_enable_x64", True)
        _keep_programs()
        matplotlib.use("Agg")
        if isinstance(sys.stdout, io.TextIOWrapper):
            sys.stdout.reconfigure(errors="replace")  # "?" for characters that a terminal lacks
        try:
            command(**options)
        except OSError as error:
            if error.strerror is None:
                raise Refusal(str(error)) from None
            what = error.filename or "A file"
            raise Refusal(f"{what} cannot be used ({plain_reason(error)}).") from None
        except ValueError as error:
            text = str(error)
            if not (isinstance(error, StoreDamaged) or text.startswith("Argument `")):
                raise
            context = click.get_current_context()
            names = {x.name: x.get_error_hint(context) for x in context.command.params}
            for argument, option in (names | OPTIONS).items():
                text = text.replace(f"Argument `{argument}`", option.strip("'"))
            text = re.sub(r"^Argument `(\w+)`", r"\1", text)  # such as an axis that is not there
            raise Refusal(text) from None

    return wrapped


def _keep_programs() -> None:
    """Let JAX keep what it compiles beside the machine code, unless it has a folder already."""
    import jax

    from .._base import private_cache
    from .._engines.processors import host_processor

    if jax.config.jax_compilation_cache_dir is not None:  # pyright: ignore
        return
    folder = private_cache.subfolder(f"programs-{host_processor().replace(' ', '-')}")
    if folder is not None:
        jax.config.update("jax_compilation_cache_dir", str(folder))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)


def plain_reason(error: OSError) -> str:
    """Why the system refused, in its words."""
    return (error.strerror or type(error).__name__).lower()


def say(text: Any) -> None:
    """Print a text or a result; once nobody reads the pipe any more, to nowhere."""
    try:
        click.echo(text)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


@contextlib.contextmanager
def waiting() -> Iterator[None]:
    """Say on a terminal that something is compiled and computed, as long as it lasts."""
    if not sys.stderr.isatty():
        yield
        return
    click.echo("compiling and computing …", err=True, nl=False)
    try:
        yield
    finally:
        click.echo("\r\x1b[K", err=True, nl=False)


@contextlib.contextmanager
def interruptible(*, keeps_tiles: bool, time_limit: float | None = None) -> Iterator[None]:
    """End the command as Ctrl-C does if a batch system stops it, or if its time is up.

    Args:
        keeps_tiles: whether the same command goes on with what is finished.
        time_limit: seconds until it stops by itself, or None.
    """
    from .._base.parallel import stop_requested, workers_are_busy

    if time_limit is not None and not hasattr(signal, "SIGALRM"):
        raise Refusal("--time-limit: this system has no alarm signal.")
    # One that is ignored, as under `nohup`, stays so.
    listened = [number for number in SIGNALS if signal.getsignal(number) != signal.SIG_IGN]
    if time_limit is not None:
        listened.append(signal.SIGALRM)
    before = {number: signal.signal(number, _stop) for number in listened}
    try:
        if time_limit is not None:
            signal.setitimer(signal.ITIMER_REAL, time_limit)
        yield
    except KeyboardInterrupt:
        status = _status[0] if _status else 128 + signal.SIGINT
        why = "The time is up" if status == TIME_IS_UP else "Stopped"
        if keeps_tiles:
            command = shlex.join(["dipoletop", *sys.argv[1:]])
            kept = f"finished tiles are kept, and this goes on from there:\n{command}"
        else:
            kept = "nothing is kept without a store."
        click.echo(f"{why}: {kept}", err=True)
        if workers_are_busy():  # Python would wait for them
            end_at_once(status)
        raise SystemExit(status) from None
    finally:
        if time_limit is not None:
            signal.setitimer(signal.ITIMER_REAL, 0)
        for number, handler in before.items():
            signal.signal(number, handler)
        stop_requested.clear()
        _status.clear()


def _stop(number: int, frame: Any) -> None:
    from .._base.parallel import stop_requested

    _status.append(TIME_IS_UP if number == getattr(signal, "SIGALRM", None) else 128 + number)
    stop_requested.set()
    raise KeyboardInterrupt


def end_at_once(status: int) -> None:
    """End the process without waiting for any thread."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)
