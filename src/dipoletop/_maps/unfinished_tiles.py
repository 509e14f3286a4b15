"""Computation of the unfinished tiles of a sweep: here, on a cluster, or by other processes."""

import contextlib
import functools
import sys
import time
import warnings
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from jaxtyping import Int

from .._base.parallel import Device, ParallelJobs
from .._base.statistics import share_of
from .._base.types import Outcome
from .cluster import on_cluster
from .grids import Sample
from .sweep_plan import Plan
from .sweep_stores import Store, ZarrStore

POLL = 0.2  # seconds between checks for tiles that other processes have finished
PATIENCE = 60.0  # seconds without a finished tile after which a warning names the claimed ones


def finish(plan: Plan, store: Store, progress: bool | str | None, client: Any = None) -> None:
    """Compute the unfinished tiles of a sweep, then close its store, so that it can be read.

    Tiles that another process computes are waited for. A progress bar tells of all of them.
    """
    from tqdm import tqdm

    with contextlib.ExitStack() as stack:
        stack.callback(store.close)
        once = functools.partial(_compute_once, plan, store)
        if client is not None:
            once = on_cluster(client, plan, store)
        waiting, totals = set(store.unfinished()), np.zeros(len(Outcome), int)
        bar = tqdm(
            desc=progress if isinstance(progress, str) else None,
            total=plan.tiling.size,
            initial=plan.tiling.size - sum(map(plan.tiling.length, waiting)),
            unit="start",
            unit_scale=True,
            disable=None if progress is None else not progress,
            file=sys.stderr,
        )
        stack.enter_context(bar)
        last, warned = time.monotonic(), False
        while waiting:
            for tile, counts in once(sorted(waiting)):
                last, warned = time.monotonic(), False
                if counts is not None:
                    totals += counts
                    bar.set_postfix_str(f"so far {_shares(plan, totals)}", refresh=False)
                bar.update(plan.tiling.length(tile))
                waiting.discard(tile)
            if waiting:
                if time.monotonic() - last > PATIENCE and not warned:
                    warned = True
                    _warn_of_claims(store, sorted(waiting))
                time.sleep(POLL)
        if isinstance(store, ZarrStore) and client is not None:
            store.reopen()  # closing removes the files that killed workers left


def _warn_of_claims(store: Store, tiles: Sequence[int]) -> None:
    """Warn that this sweep waits for tiles that another process has claimed."""
    shown = ", ".join(str(tile) for tile in tiles[:8]) + (", …" if len(tiles) > 8 else "")
    where = f" of {store.tiles.folder}" if isinstance(store, ZarrStore) else ""
    warnings.warn(
        f"Waiting for tiles {shown}{where}, which another process has claimed, but has not written "
        f"for {PATIENCE:g} s: it may be slow, or stopped. If it ends, they are computed here.",
        stacklevel=4,
    )


def _shares(plan: Plan, totals: Int[np.ndarray, "outcomes"]) -> str:
    """Return such as "residual 46.6%, stop 53.4%", with 95 % intervals for random starts."""
    counts, parts = dict(zip(Outcome, totals.tolist(), strict=True)), []
    for outcome in (Outcome.RESIDUAL, Outcome.STOP, Outcome.UNDECIDED, Outcome.FAILED):
        if counts[outcome]:
            share = share_of(counts[outcome], sum(counts.values()))
            part = f"{outcome.name.lower()} {share.share:.1%}"
            if isinstance(plan.blocks.over, Sample):
                part += f" ({100 * share.low:.1f}-{100 * share.high:.1f})"
            parts.append(part)
    return ", ".join(parts)


def _compute_once(plan: Plan, store: Store, tiles: Sequence[int]) -> Iterator[tuple[int, Any]]:
    """Yield the tiles as they are finished, here or by other processes; some may remain.

    With a tile that this sweep has computed come the counts of its outcomes, else None.

    The thread that has computed a tile also writes it: creating files takes as long as computing.
    After an interruption, the tiles in progress are kept if they do not take much longer.
    """
    queues = plan.queues(tiles)

    def work(queue: int, device: Device) -> dict[int, Int[np.ndarray, "outcomes"]]:
        claimed = [tile for tile in queues[queue] if store.claim(tile)]
        computed = plan.compute(claimed, device) if claimed else []
        for found in computed:
            store.write(found)
        return {found.tile: found.outcomes for found in computed}

    jobs = ParallelJobs(work, range(len(queues)), plan.devices)
    try:
        for queue, counts in jobs.results():
            for tile in queues[queue]:
                if store.is_finished(tile):
                    yield tile, counts.get(tile)
    except KeyboardInterrupt:
        for _ in jobs.rest(store.patience):
            pass
        raise
    except BaseException:
        jobs.wait()
        raise
