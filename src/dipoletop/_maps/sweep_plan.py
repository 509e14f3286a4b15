"""The plan of a sweep: its checked arguments, and from them the columns of each tile."""

import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from .._base.checks import names_of
from .._base.compiling import UNTRACED, in_a_trace
from .._base.parallel import Device, worker_devices
from .._base.refusals import refuse
from .._base.tolerances import tolerance
from .._base.types import Equation
from .._engines.interface import Engine, power_of_two
from .._engines.processors import kind_of
from .._runs.blocks import Place, classify_block
from .._runs.classification import Value
from .._runs.memory_limits import TILE, largest_tile
from .._runs.run_settings import RunSettings
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


@dataclass(frozen=True)
class Plan:
    """The plan of a sweep.

    Attributes:
        blocks: function from points to the equations and starts of a tile.
        equation: the equation, with the shapes and types of its arrays for one point.
        settings: how the runs are made.
        confirm: a second tolerance, if outcomes are to be confirmed.
        reduction: the counts to keep, if starts are not kept.
        devices: the devices, each repeated once for each of its threads.
        engines: the engine of each device.
        cut: function from the shape of the starts to their tiling.
        threads: number of threads for one tile in an engine that has its own.
    """

    blocks: BlockBuilder
    equation: Equation
    settings: RunSettings
    confirm: Float[np.ndarray, ""] | None
    reduction: Reduction | None
    devices: list[Device]
    engines: Mapping[Device, Engine]
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
        confirmed = [] if self.confirm is None else ["changed"]
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
        given, derivatives = self.settings, list(self.blocks.derivatives)
        exact = given.value or given.atol is not None
        return {
            "level": level_of(self.equation),
            "rtol": float(given.rtol),
            "atol": float(given.atol or 0) if exact else ATOL_OF_LABELS,
            "max_steps": given.max_steps,
            "value": given.value,
            "engine": self.engines[self.devices[0]].name,
            "processor": kind_of(self.devices[0]),
            "slow_flow": given.slow_flow,
            **({"derivatives": derivatives} if derivatives else {}),
            **({} if self.confirm is None else {"confirm": float(self.confirm)}),
            **self.blocks.over.header.settings,
            **_versions(),
        }

    def header(self) -> dict[str, Any]:
        """Return the data that identify this sweep, except the swept values."""
        over, reduction = self.blocks.over, self.reduction
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
        columns = self._columns(queue, is_real, self.settings, device)
        if self.confirm is not None:
            strict = self.settings._replace(rtol=self.confirm, in_two_passes=False)
            other = self._columns(queue, is_real, strict, device)
            columns["changed"] = columns["outcome"] != other["outcome"]
        results = []
        for i, tile in enumerate(tiles):
            lanes = slice(firsts[i], firsts[i] + lengths[i])
            found = {name: x[lanes] for name, x in columns.items()}
            outcomes = counted_outcomes(found["outcome"])
            if reduction := self.reduction:
                kept = {"counts": reduction.counts(found, self.tiling, tile)[None]}
            else:
                kept = found | drawn_values(self.drawn, points[i], real[i])
            results.append(ComputedTile(tile, kept, block_digest(real[i]), outcomes))
        return results

    def _columns(
        self, block: StartBlock, is_real: np.ndarray, settings: RunSettings, device: Device
    ) -> Columns:
        equation, omegas = block
        limits = settings.limits(equation, omegas, is_real)  # padding takes no step
        place = Place(self.engines[device], device, self.threads)
        ends = classify_block(equation, omegas, limits, settings, place)
        columns = {name: np.asarray(getattr(ends, name), x.dtype) for name, x in COLUMNS.items()}
        for k, name in enumerate(self.blocks.derivatives):
            columns[DERIVATIVE_PREFIX + name] = np.asarray(ends.slopes)[k]
        return columns


def plan_of(
    problem: Problem,
    over: Grid | Points | Sample,
    settings: RunSettings,
    *,
    derivatives: str | Sequence[str] = (),
    confirm: Any = None,
    reduction: Reduction | None = None,
) -> Plan:
    """Return the plan of a sweep after checking its arguments; see `Plan` and `sweep`.

    Raises:
        ValueError: bad arguments.
    """
    if in_a_trace():
        refuse("problem", UNTRACED, "is swept within a trace")
    blocks = BlockBuilder(problem, over, derivative_names(derivatives, settings.value))
    devices = worker_devices(settings.devices)
    equation, _ = blocks.template()
    settings = settings.checked(equation)
    confirm = None if confirm is None else tolerance("confirm", confirm, xp=np)
    engines = settings.engines(equation, devices)
    return Plan(blocks, equation, settings, confirm, reduction, devices, engines)


def drawn_values(names: Iterable[str], points: Any, block: StartBlock) -> dict[str, np.ndarray]:
    """Return the starts and parameters of a sample's points, one for each lane of the block."""
    starts = block[1].T
    values = {name: starts if name == START else points[name][: len(starts)] for name in names}
    return {name: np.asarray(column, float) for name, column in values.items()}


@functools.cache  # it reads files
def _versions() -> dict[str, str]:
    return {f"{VERSION}{name}": version(name) for name in ("dipoletop", "jax", "diffrax")}
