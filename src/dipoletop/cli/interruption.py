"""How long commands end when Ctrl-C, a batch system or a time limit stops them."""

import contextlib
import os
import shlex
import signal
import sys
from collections.abc import Iterator
from typing import Any

import click

from .._base.parallel import stop_requested, workers_are_busy
from .refusals import Refusal

NAMES = "SIGINT", "SIGTERM", "SIGHUP"
SIGNALS = [getattr(signal, name) for name in NAMES if hasattr(signal, name)]
TIME_IS_UP = 124  # exit status, as of `timeout`
_status: list[int] = []  # the exit status of the first signal


@contextlib.contextmanager
def interruptible(*, keeps_tiles: bool, time_limit: float | None = None) -> Iterator[None]:
    """End the command as Ctrl-C does if a batch system stops it, or if its time is up.

    Args:
        keeps_tiles: whether the same command goes on with what is finished.
        time_limit: seconds until it stops by itself, or None.
    """
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
        _end(status)
    finally:
        if time_limit is not None:
            signal.setitimer(signal.ITIMER_REAL, 0)
        for number, handler in before.items():
            signal.signal(number, handler)
        stop_requested.clear()
        _status.clear()


def _stop(number: int, frame: Any) -> None:
    _status.append(TIME_IS_UP if number == getattr(signal, "SIGALRM", None) else 128 + number)
    stop_requested.set()
    raise KeyboardInterrupt


def _end(status: int) -> None:
    """End the process, at once if a worker is busy: Python would wait for it."""
    if workers_are_busy():
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)
    raise SystemExit(status)
