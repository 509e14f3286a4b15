"""What a sweep computes: its arguments, checked, and from them the columns of each tile."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._base.checks import names_of, refuse
from .._base.parallel import Device
from .._base.tolerances import absolute
from .._base.types import Equation
from .._engines.interface import Engine, Limits, power_of_two
from .._runs.blocks import classify_block
from .._runs.classification import Value
from .._runs.classify_many import TILE, largest_tile
from .._runs.slow_runs import SlowFlow
from ..equations.levels import level_of
from .columns import DERIVATIVE_PREFIX, columns_of_runs
from .problems import Block, BlockBuilder
from .tiling import Tiling

Columns = dict[str, np.ndarray]


def derivative_names(derivatives: str | Sequence[str], value: Value) -> tuple[str, ...]:
    """The arguments along which ω∞ is differentiated, checked."""
    names = names_of("derivatives", derivatives)
    if len(set(names)) < len(names):
        refuse("derivatives", "name each argument once", f"is {', '.join(names)}")
    if names and not value:
        refuse("value", "be True if there are derivatives of ω∞ to be found", "is False")
    return names


class Rules(NamedTuple):
    """How exactly the runs of a sweep are made, and when they end."""

    rtols: list[Float[Array, ""]]
    """The tolerance of the columns; then, if outcomes are to be confirmed, a second one."""
    atol: Any
    """The absolute tolerance as the user gave it; see `sweep` for None."""
    max_steps: int
    """Budget of every run."""
    value: Value
    """Whether ω∞ is wanted, and with an estimate of its error."""
    slow_flow: SlowFlow
    """Whether slow runs are predicted."""


@dataclass(frozen=True)
class Plan:
    """All that a sweep computes.

    Attributes:
        blocks: builds the equations and starts of a tile.
        equation: the equation of the first point.
        rules: tolerances and budgets.
        devices: the devices, each as often as there are threads for it.
        engines: the engine of each device.
    """

    blocks: BlockBuilder
    equation: Equation
    rules: Rules
    devices: list[Device]
    engines: dict[Device, Engine]

    @property
    def tiling(self) -> Tiling:
        """Tiles have the same size on every machine, so that a store may move to another one."""
        size = int(np.prod(self.blocks.over.shape))
        return Tiling(size, min(TILE, power_of_two(-(-size // 8))))

    @property
    def column_names(self) -> list[str]:
        """Names of the columns, in order."""
        derivatives = [DERIVATIVE_PREFIX + name for name in self.blocks.derivatives]
        confirmed = ["changed"] if len(self.rules.rtols) > 1 else []
        return [*columns_of_runs(self.rules.slow_flow), *derivatives, *confirmed]

    @property
    def attrs(self) -> dict[str, Any]:
        """The attributes of the basin: level, settings, versions."""
        rtols, atol, max_steps, value, slow_flow = self.rules
        derivatives = list(self.blocks.derivatives)
        return {
            "level": level_of(self.equation),
            "rtol": float(rtols[0]),
            "atol": float(atol or 0) if value or atol is not None else "rtol*|omega_0|",
            "max_steps": max_steps,
            "value": value,
            "engine": self.engines[self.devices[0]].name,
            **({} if slow_flow is False else {"slow_flow": slow_flow}),
            **({"derivatives": derivatives} if derivatives else {}),
            **({"confirm": float(rtols[1])} if len(rtols) > 1 else {}),
            **_versions(),
        }

    def header(self) -> dict[str, Any]:
        """All that tells this sweep from another one, except the swept values."""
        over = self.blocks.over
        digests = self.blocks.program_digests()
        return {
            "dims": list(over.dims),
            "shape": list(over.shape),
            "tile": self.tiling.tile_size,
            "columns": self.column_names,
            "attrs": self.attrs,
            "axes": list(over.coords),
            "over": over.header.kind,
            "settings": over.header.settings,
            "type": str(jnp.result_type(float)),
            "programs": {name: program.hex() for name, program in digests.items()},
        }

    def block(self, tile: int) -> Block:
        """Equations and starts of a tile; the last tile is filled up to full length."""
        return self.blocks(self.tiling.padded_indices(tile))

    def queues(self, tiles: Sequence[int]) -> list[Sequence[int]]:
        """The tiles that are computed in one queue; several on accelerators.

        A store keeps its tiles whatever the device, and no run sees its neighbours.
        """
        starts = largest_tile(self.devices)
        shared = -(-len(tiles) // len(self.devices))  # every device has work
        length = min(starts // self.tiling.tile_size, shared) if starts > TILE else 1
        length = max(length, 1)
        return [tiles[i : i + length] for i in range(0, len(tiles), length)]

    def compute(
        self, tiles: Sequence[int], device: Device
    ) -> list[tuple[int, tuple[Columns, Block]]]:
        """The columns of each tile, and the equations and starts that they belong to."""
        blocks = [self.block(tile) for tile in tiles]
        is_real = np.concatenate([self.tiling.is_real(tile) for tile in tiles])
        queue = _joined(blocks)
        columns, *confirming = [
            self._columns(queue, is_real, rtol, device, loosely=number == 0)
            for number, rtol in enumerate(self.rules.rtols)
        ]
        for other in confirming:
            columns["changed"] = columns["outcome"] != other["outcome"]
        results = []
        for i, (tile, block) in enumerate(zip(tiles, blocks, strict=True)):
            first = i * self.tiling.tile_size
            lanes = slice(first, first + self.tiling.length(tile))
            results.append((tile, ({name: x[lanes] for name, x in columns.items()}, block)))
        return results

    def _columns(
        self,
        block: Block,
        is_real: np.ndarray,
        rtol: Float[Array, ""],
        device: Device,
        *,
        loosely: bool,
    ) -> Columns:
        (equation, omegas), (_, atol, max_steps, value, slow_flow) = block, self.rules
        end = np.where(is_real, np.inf, 0.0)  # padding takes no step
        atol = absolute(atol, rtol, omegas, label_only=not value)
        limits = Limits(rtol, atol, end, jnp.asarray(max_steps))
        where = {"engine": self.engines[device], "device": device}
        rules = {"value": value, "slow_flow": slow_flow, "loosely": loosely}
        ends = classify_block(equation, omegas, limits, **where, **rules)
        kept = columns_of_runs(slow_flow).items()
        columns = {name: np.asarray(getattr(ends, name), x.dtype) for name, x in kept}
        for k, name in enumerate(self.blocks.derivatives):
            columns[DERIVATIVE_PREFIX + name] = np.asarray(ends.slopes)[k]
        return columns


def _joined(blocks: Sequence[Any]) -> Any:
    """One block of the lanes of several."""
    if len(blocks) == 1:
        return blocks[0]
    arrays, rest = zip(*(eqx.partition(block, _is_array) for block in blocks), strict=True)
    joined = jax.tree.map(lambda *parts: jnp.concatenate(parts, axis=-1), *arrays)
    return eqx.combine(joined, rest[0])


def _is_array(leaf: Any) -> bool:
    return isinstance(leaf, jax.Array | np.ndarray)


@functools.cache  # it reads files
def _versions() -> dict[str, str]:
    return {f"version_{name}": version(name) for name in ("dipoletop", "jax", "diffrax")}
