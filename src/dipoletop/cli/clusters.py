"""The Dask cluster of `dipoletop map --scheduler`: what is wrong with it is told in a sentence."""

import asyncio
import contextlib
import logging
from collections.abc import Iterator
from typing import Any

import click

from .._base.checks import one_line
from .._maps.cluster import await_worker
from .running import Refusal

CONNECT = 20.0  # seconds within which the scheduler must answer
JOIN = 300.0  # seconds within which a worker must; they may just be starting


@contextlib.contextmanager
def cluster_client(address: str | None, has_store: bool) -> Iterator[Any]:
    """A client of the scheduler at an address, once a worker has answered; None without one.

    Raises:
        Refusal: the cluster cannot be used.
        ValueError: the scheduler or the worker has no dipoletop.
    """
    if address is None:
        yield None
        return
    if not has_store:
        raise Refusal("--scheduler needs a store, which its workers write: leave --no-store out.")
    with _connected(address) as client:
        if not client.nthreads():
            click.echo(f"{address} has no workers yet: waiting for one.", err=True)
        try:
            await_worker(client, JOIN)
        except TimeoutError:
            raise Refusal(f"--scheduler {address}: no worker has answered in {JOIN:g} s.") from None
        yield client


def _connected(address: str) -> Any:
    """A client of the scheduler at an address."""
    try:
        from distributed import Client
    except ImportError:
        raise Refusal("--scheduler needs dask: pip install 'dipoletop[dask]'.") from None
    # What it logs when a scheduler is lost are tracebacks; here that is told in a sentence.
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        asyncio.run(asyncio.wait_for(_greet(address), CONNECT))
        return Client(address, timeout=CONNECT)
    except ValueError as error:
        said = f"it is no address such as tcp://host:8786 ({one_line(error)})"
    except OSError:
        said = f"no Dask scheduler answers there within {CONNECT:g} s"
    raise Refusal(f"--scheduler {address}: {said}.")


async def _greet(address: str) -> None:
    """Connect and close: a `Client` would wait for ever for a server that accepts and is silent."""
    from distributed.comm.core import connect

    comm = await connect(address, timeout=CONNECT)
    await comm.close()
