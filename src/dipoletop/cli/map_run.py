"""A sweep for `dipoletop map`: its devices and cluster, what it cost, and what it found."""

import asyncio
import contextlib
import dataclasses
import logging
import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import click
import jax
import numpy as np

from .._base.monitoring import COMPILING
from .._base.refusals import one_line
from .._base.types import Outcome, Regime
from .._maps.basin import Basin
from .._maps.cluster import await_worker
from .._maps.grids import Grid
from .._maps.store.errors import StoreMismatch
from .._maps.store.saved_basins import starts_done
from .._maps.sweep import sweep
from .._maps.top_problems import problem_of_top
from .._maps.unfolded_basins import unfold
from ..equations.levels import Level
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


def devices_of(kind: str | None) -> list[Any] | None:
    """JAX's devices of a kind; None means all."""
    if kind is None:
        return None
    try:
        return jax.devices(kind)
    except RuntimeError:
        raise Refusal(f"--device {kind}: JAX finds none on this machine.") from None


class Run(NamedTuple):
    """A sweep at one level, and what it cost."""

    basin: Basin
    store: Path | None
    stored: int
    """Starts that the store held already."""
    compiling: float
    """Seconds in which something was compiled."""


def run_level(level: Level, grid: Grid, store: Path | None, **settings: Any) -> Run:
    """Sweep the grid at one level; `settings` are those of `sweep`.

    Raises:
        ValueError: bad settings.
        Refusal: a store with something else in it.
    """
    stored = 0 if store is None else starts_done(store, settings.get("repair", False))
    try:
        with measure_compile_time() as seconds:
            basin = sweep(problem_of_top(level), grid, store=store, **settings)
    except StoreMismatch as error:
        reason = error.reason.replace("`slow_flow=False`", "--slow-flow off")
        raise Refusal(f"{reason}; choose another --output, or remove it.") from None
    return Run(basin, store, stored, seconds())


@contextlib.contextmanager
def measure_compile_time() -> Iterator[Callable[[], float]]:
    """A function that returns for how many seconds any thread was tracing or compiling.

    JAX reports the end and the duration of every such event. Threads may compile at the same time,
    so the result is the length of the union of all these intervals.
    """
    intervals: list[tuple[float, float]] = []

    def listen(event: str, duration_secs: float, **_: Any) -> None:
        if event.startswith(("/jax/core/compile/", COMPILING)):
            now = time.perf_counter()
            intervals.append((now - duration_secs, now))

    def length_of_union() -> float:
        total, covered_until = 0.0, -math.inf
        for begin, end in sorted(intervals):
            total += max(0.0, end - max(begin, covered_until))
            covered_until = max(covered_until, end)
        return total

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        yield length_of_union
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)


def lines_of(run: Run) -> Iterator[str]:
    """What a sweep gave, what it cost, and what it did not have to do."""
    basin = run.basin
    outcome, time, steps, regime = basin.outcome, basin.time, basin.steps, basin.regime
    decided = (outcome == Outcome.RESIDUAL) | (outcome == Outcome.STOP)
    unknown = (outcome == Outcome.RESIDUAL) & np.isnan(basin.omega_inf)
    resolved = regime == Regime.RESOLVED
    chance = basin.probability[outcome == Outcome.UNDECIDED]
    computed, seconds = steps.size - run.stored, basin.seconds - run.compiling
    yield repr(basin)
    if run.stored:
        yield f"{run.stored} starts found in the store"
    if computed:
        speed = f"{seconds:.1f} s, {computed / seconds:,.0f} per second"
        apart = f"{run.compiling:.1f} s of compilation apart"
        yield f"{computed} starts computed in {speed}, engine {basin.attrs['engine']}; {apart}"
    at_once = np.sum(decided & (time == 0))
    mean, most = np.mean(steps), np.max(steps)
    yield f"{mean:.1f} steps on average, at most {most}; {at_once} starts decided without a step"
    if np.any(known := decided & ~np.isnan(time)):
        median, last = np.median(time[known]), np.max(time[known])
        yield f"certain at τ = {median:.3g} (median), at most {last:.3g}"
    for law in Regime:
        if law != Regime.RESOLVED and (count := np.sum(regime == law)):
            yield f"{count} starts predicted: {law.name}"
    if (chance := chance[np.isfinite(chance)]).size:
        mean = f"residual with probability {np.mean(chance):.3f} on average"
        yield f"{chance.size} starts undecided, a matter of chance: {mean}"
    if count := np.sum(unknown & resolved):
        yield f"{count} starts with ω∞ not known: its error may exceed it"
    if count := np.sum(unknown & ~resolved):
        yield f"{count} starts with ω∞ not known: its sign is a matter of chance"
    if "changed" in basin.columns:
        yield f"{np.sum(basin.changed)} starts changed at the second tolerance"


def remarks_on(basins: list[Basin]) -> Iterator[str]:
    """How two levels differ, and what was not computed."""
    first = basins[0]
    size = math.prod(first.shape)
    if len(basins) == 2:
        differ = int(np.sum(first.outcome != basins[1].outcome))
        yield f"Outcome differs between the levels: {differ} starts, {differ / size:.2%}."
    whole = math.prod(unfold(dataclasses.replace(first, columns={})).shape)
    if whole > size:
        left = f"{whole - size} of {whole} starts of the whole plane ({1 - size / whole:.0%})"
        yield f"Not computed: {left}, which follow by symmetry."
