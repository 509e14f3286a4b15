"""The plan of a sweep: its checked arguments, and from them the columns of each tile."""

import functools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._base.checks import check_verdict, names_of, refuse
from .._base.parallel import Device, worker_devices
from .._base.tolerances import MAX_STEPS, absolute, budget, check_atol, tolerance
from .._base.types import Equation
from .._engines.interface import Engine, Limits, power_of_two
from .._engines.processors import kind_of
from .._engines.select import select_engines
from .._runs.blocks import RunOptions, classify_block
from .._runs.classification import Value, stopping_rule
from .._runs.label_doubt import exact_when_slow, finish_of
from .._runs.memory_limits import TILE, largest_tile
from .._runs.slow_runs import SlowFlow, check_slow_flow
from ..equations.levels import level_of
from .columns import COLUMNS, DERIVATIVE_PREFIX, START, VERSION, check_arguments
from .grids import Grid, Points, PointValues, Sample
from .problems import BlockBuilder, Problem, StartBlock, block_digest, first_lanes, joined
from .tally_counts import Reduction, counted_outcomes
from .tiling import Tiling

Columns = dict[str, np.ndarray]
ATOL_OF_LABELS = "rtol*|omega_0| where all slow motions have the same outcome, else 0"


class ComputedTile(NamedTuple):
    """A tile that has been computed."""

    tile: int
    columns: Columns
    """The columns that are kept."""
    inputs: bytes
    """A digest of its equations and starts."""
    outcomes: Int[np.ndarray, "outcomes"]
    """Numbers of its starts with each outcome."""


def derivative_names(derivatives: str | Sequence[str], value: Value) -> tuple[str, ...]:
    """Return the arguments along which ω∞ is differentiated, after checking them."""
    names = names_of("derivatives", derivatives)
    if len(set(names)) < len(names):
        refuse("derivatives", "name each argument once", f"is {', '.join(names)}")
    if names and not value:
        refuse("value", "be True if there are derivatives of ω∞ to be found", "is False")
    return names


class Settings(NamedTuple):
    """The arguments of a sweep that say how to compute it; see `sweep`."""

    rtol: Any = 1e-8
    atol: Any = None
    max_steps: Any = MAX_STEPS
    value: Value = True
    derivatives: str | Sequence[str] = ()
    confirm: Any = None
    engine: str = "auto"
    slow_flow: SlowFlow = "auto"
    devices: Sequence[Any] | None = None
    reduction: Reduction | None = None
    """The counts to keep, if starts are not kept."""


@dataclass(frozen=True)
class Plan:
    """The plan of a sweep.

    Attributes:
        blocks: function from points to the equations and starts of a tile.
        equation: the equation, with the shapes and types of its arrays for one point.
        rtols: the tolerance of the columns and, if outcomes are to be confirmed, a second one.
        devices: the devices, each repeated once for each of its threads.
        engines: the engine of each device.
        settings: the checked arguments.
        cut: function from the shape of the starts to their tiling.
        threads: number of threads for one tile in an engine that has its own.
    """

    blocks: BlockBuilder
    equation: Equation
    rtols: list[Float[Array, ""]]
    devices: list[Device]
    engines: dict[Device, Engine]
    settings: Settings
    cut: Callable[[tuple[int, ...]], Tiling] = Tiling.of_sweep
    threads: int = 1

    @functools.cached_property
    def tiling(self) -> Tiling:
        """The division of the starts into tiles."""
        return self.cut(self.blocks.over.shape)

    @property
    def column_names(self) -> list[str]:
        """Names of the columns, in order."""
        derivatives = [DERIVATIVE_PREFIX + name for name in self.blocks.derivatives]
        confirmed = [] if self.settings.confirm is None else ["changed"]
        return [*COLUMNS, *derivatives, *confirmed, *self.drawn]

    @functools.cached_property
    def drawn(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the start and the parameters that are kept for every point of a sample."""
        over = self.blocks.over
        if not isinstance(over, Sample):
            return {}
        point = jax.eval_shape(over.draw, jax.random.key(0))
        parameters = {name: x.shape for name, x in point.items()} if isinstance(point, dict) else {}
        check_arguments("draw", parameters)
        return {START: (3,)} | {name: x for name, x in parameters.items() if name != START}

    @property
    def attrs(self) -> dict[str, Any]:
        """The attributes of the basin: level, settings, versions."""
        given, rtols, derivatives = self.settings, self.rtols, list(self.blocks.derivatives)
        exact = given.value or given.atol is not None
        return {
            "level": level_of(self.equation),
            "rtol": float(rtols[0]),
            "atol": float(given.atol or 0) if exact else ATOL_OF_LABELS,
            "max_steps": given.max_steps,
            "value": given.value,
            "engine": self.engines[self.devices[0]].name,
            "processor": kind_of(self.devices[0]),
            "slow_flow": given.slow_flow,
            **({"derivatives": derivatives} if derivatives else {}),
            **({"confirm": float(rtols[1])} if len(rtols) > 1 else {}),
            **self.blocks.over.header.settings,
            **_versions(),
        }

    def header(self) -> dict[str, Any]:
        """Return the data that identify this sweep, except the swept values."""
        over, reduction = self.blocks.over, self.settings.reduction
        digests = self.blocks.program_digests()
        header = {
            "dims": list(over.dims),
            "shape": list(over.shape),
            "chunk": list(self.tiling.chunk),
            "columns": self.column_names,
            "drawn": self.drawn,
            "attrs": self.attrs,
            "axes": list(over.coords),
            "over": over.header.kind,
            "type": str(jnp.result_type(float)),
            "programs": {name: program.hex() for name, program in digests.items()},
        }
        return header if reduction is None else reduction.header(header, self.tiling)

    def points(self, tile: int, device: Device) -> PointValues:
        """Return the points of a tile, padded to a common length, so that programs fit all."""
        compiles = self.engines[device].compiles_for_size
        size = power_of_two(self.tiling.tile_size) if compiles else self.tiling.tile_size
        return self.blocks.over.points(self.tiling.padded_indices(tile, size))

    def inputs(self, tile: int, device: Device) -> bytes:
        """Return a digest of the equations and starts of a tile."""
        block = self.blocks(self.points(tile, device))
        return block_digest(first_lanes(block, self.tiling.length(tile)))

    def queues(self, tiles: Sequence[int]) -> list[Sequence[int]]:
        """Return groups of tiles, each computed in one queue; on accelerators, of several tiles.

        The tiles of a store do not depend on the device, and runs do not depend on each other.
        """
        starts = largest_tile(self.devices)
        shared = -(-len(tiles) // len(self.devices))  # every device has work
        length = min(starts // power_of_two(self.tiling.tile_size), shared) if starts > TILE else 1
        length = max(length, 1)
        return [tiles[i : i + length] for i in range(0, len(tiles), length)]

    def compute(self, tiles: Sequence[int], device: Device) -> list[ComputedTile]:
        """Compute the columns of each tile, and a digest of its equations and starts."""
        points = [self.points(tile, device) for tile in tiles]
        padded = [self.blocks(of_tile) for of_tile in points]
        lengths = [self.tiling.length(tile) for tile in tiles]
        real = [first_lanes(block, n) for block, n in zip(padded, lengths, strict=True)]
        used = padded if self.engines[device].compiles_for_size else real
        sizes = [omegas.shape[1] for _, omegas in used]
        firsts = np.cumsum([0, *sizes])
        is_real = np.concatenate(
            [np.arange(size) < n for size, n in zip(sizes, lengths, strict=True)]
        )
        queue = joined(used)
        columns, *confirming = [
            self._columns(queue, is_real, rtol, device, loosely=number == 0)
            for number, rtol in enumerate(self.rtols)
        ]
        for other in confirming:
            columns["changed"] = columns["outcome"] != other["outcome"]
        results = []
        for i, tile in enumerate(tiles):
            lanes = slice(firsts[i], firsts[i] + lengths[i])
            found = {name: x[lanes] for name, x in columns.items()}
            outcomes = counted_outcomes(found["outcome"])
            if reduction := self.settings.reduction:
                kept = {"counts": reduction.counts(found, self.tiling, tile)[None]}
            else:
                kept = found | drawn_values(self.drawn, points[i], real[i])
            results.append(ComputedTile(tile, kept, block_digest(real[i]), outcomes))
        return results

    def _columns(
        self,
        block: StartBlock,
        is_real: np.ndarray,
        rtol: Float[Array, ""],
        device: Device,
        *,
        loosely: bool,
    ) -> Columns:
        (equation, omegas), given = block, self.settings
        end = np.where(is_real, np.inf, 0.0)  # padding takes no step
        atol = absolute(given.atol, rtol, omegas, exact_when_slow(equation, given.value))
        limits = Limits(rtol, atol, end, jnp.asarray(given.max_steps))
        engine, slow_flow = self.engines[device], given.slow_flow
        way = RunOptions(given.value, engine, device, slow_flow, self.threads, loosely)
        ends = classify_block(equation, omegas, limits, way)
        columns = {name: np.asarray(getattr(ends, name), x.dtype) for name, x in COLUMNS.items()}
        for k, name in enumerate(self.blocks.derivatives):
            columns[DERIVATIVE_PREFIX + name] = np.asarray(ends.slopes)[k]
        return columns


def plan_of(problem: Problem, over: Grid | Points | Sample, settings: Settings) -> Plan:
    """Return the plan of a sweep after checking its arguments.

    Raises:
        ValueError: bad arguments.
    """
    rtol, atol, max_steps, value, derivatives, confirm, engine, slow_flow, devices, _ = settings
    # convert
    blocks = BlockBuilder(problem, over, derivative_names(derivatives, value))
    if atol is not None:
        check_atol(atol)
    rtols = [tolerance("rtol", rtol)]
    if confirm is not None:
        rtols.append(tolerance("confirm", confirm))
    settings = settings._replace(max_steps=budget("max_steps", max_steps))
    devices = worker_devices(devices)
    # check
    equation, _ = blocks.template()
    check_verdict(equation)
    check_slow_flow(slow_flow, equation)
    until, finish = stopping_rule(equation, value), finish_of(value)
    engines = select_engines(engine, equation, devices, until, finish)
    return Plan(blocks, equation, rtols, devices, engines, settings)


def drawn_values(names: Iterable[str], points: Any, block: StartBlock) -> dict[str, np.ndarray]:
    """Return the starts and parameters of a sample's points, one for each lane of the block."""
    (_, omegas), length = block, block[1].shape[1]
    values = {name: omegas.T if name == START else points[name][:length] for name in names}
    return {name: np.asarray(column, float) for name, column in values.items()}


@functools.cache  # it reads files
def _versions() -> dict[str, str]:
    return {f"{VERSION}{name}": version(name) for name in ("dipoletop", "jax", "diffrax")}
