"""What `dipoletop map` does: the grid of two quantities, its sweeps, and what is said of them."""

import contextlib
import math
import time
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .._base.checks import refuse
from .._base.monitoring import COMPILING
from .._base.statistics import Share
from .._base.types import Outcome
from .._maps.basin import Basin
from .._maps.grids import Grid
from .._maps.store.contents import starts_done, verify
from .._maps.store.errors import StoreMismatch
from .._maps.store.tiles import open_store
from .._maps.sweep import sweep
from .._maps.symmetry import unfold
from ..equations.levels import Level
from ..equations.transverse import TransverseReduced, cylindrical, equation_at


class Quantity(NamedTuple):
    """What a map may vary: its symbol, default value, and default range."""

    symbol: str
    value: float
    low: float
    high: float


QUANTITIES = {
    "delta": Quantity("δ", -0.2, -1.0, 0.9),
    "w-perp": Quantity("ω⊥", 0.2, 0.0, 0.5),
    "w3": Quantity("ω₃", 0.2, 0.0, 0.6),
    "phi": Quantity("φ", math.pi / 30, 0.0, math.pi),
    "amplitude": Quantity("|ω|", 0.2, 0.02, 0.5),
    "theta": Quantity("θ", math.pi / 4, 0.0, math.pi / 2),
}
ENGINES = {"native": "native (machine code)", "jax": "JAX"}
CYLINDRICAL, SPHERICAL = {"w-perp", "w3"}, {"amplitude", "theta"}


class Run(NamedTuple):
    """A sweep at one level, and what it cost."""

    basin: Basin
    store: Path | None
    before: int
    """Starts that the store held already."""
    compiling: float
    """Seconds in which something was compiled."""


def start(at: dict[str, Any]) -> Any:
    """ω₀ from the quantities by their names."""
    if "amplitude" not in at:
        return cylindrical(at["w-perp"], at["w3"], at["phi"])
    size, theta = at["amplitude"], at["theta"]
    return cylindrical(size * jnp.sin(theta), size * jnp.cos(theta), at["phi"])


def quantities(given: dict[str, float | None], axes: tuple[str, ...] = ()) -> dict[str, float]:
    """δ and the start, as given or by default; `axes` will be varied.

    Raises:
        ValueError: an axis that is given, ω⊥ or ω₃ with |ω| or θ, or values that cannot be.
    """
    known = {name: value for name, value in given.items() if value is not None}
    for name in known:
        if name in axes:
            raise ValueError(f"--{name} would fix an axis of the map; use --range {name} LOW HIGH.")
    named = {*axes, *known}
    if named & SPHERICAL and named & CYLINDRICAL:
        raise ValueError(
            f"{' and '.join(sorted(named & (SPHERICAL | CYLINDRICAL)))} cannot be mixed: "
            "the start is given by w-perp and w3, or by amplitude and theta."
        )
    left_out = CYLINDRICAL if named & SPHERICAL else SPHERICAL
    found = {name: known.get(name, q.value) for name, q in QUANTITIES.items()}
    found = {name: value for name, value in found.items() if name not in left_out}
    for name, value in found.items():
        _check(name, value)
    return found


def _check(name: str, *values: float) -> None:
    for value in values:
        if name in ("w-perp", "amplitude") and value < 0:
            raise ValueError(f"{name} must not be negative, but is {value:g}.")
        if name == "theta" and not 0 <= value <= math.pi:
            raise ValueError(f"theta must lie between 0 and pi, but is {value:g}.")
        if name == "delta":
            TransverseReduced(value)  # which refuses a δ that no body has


def make_grid(
    given: dict[str, float | None],
    axes: tuple[str, str],
    ranges: dict[str, tuple[float, float]],
    size: tuple[int, int],
) -> tuple[Grid, str]:
    """The grid over two quantities, and a line that describes it.

    What is fixed is an axis of length 1, so that the data say everything; x is the last axis.

    Raises:
        ValueError: axes, ranges or values that do not go together.
    """
    if axes[0] == axes[1]:
        raise ValueError(f"--x and --y must be two different quantities, but are both {axes[0]}.")
    for name in ranges:
        if name not in axes:
            raise ValueError(f"--range {name}: the axes of this map are {axes[0]} and {axes[1]}.")
    values: dict[str, Any] = dict(quantities(given, axes))
    spans = []
    for name, n in zip(axes, size, strict=True):
        symbol, _, *usual = QUANTITIES[name]
        low, high = ranges.get(name, usual)
        if not low < high:
            raise ValueError(f"--range {name}: {low:g} must be less than {high:g}.")
        _check(name, low, high)
        turns = (high - low) / math.pi
        # After φ → φ + π the outcomes repeat: such a range ends where it starts.
        again = name == "phi" and math.isclose(turns, round(turns), abs_tol=1e-9)
        values[name] = np.linspace(low, high, n, endpoint=not again)
        spans.append(f"{symbol} from {_text(low)} to {_text(high)}")
    fixed = describe({name: value for name, value in values.items() if name not in axes})
    text = f"{size[0]} × {size[1]} starts: {', '.join(spans)}, at {fixed}"
    order = sorted(values, key=lambda name: (name in axes) + (name == axes[0]))
    return Grid(**{name.replace("-", "_"): values[name] for name in order}), text


def describe(values: dict[str, float]) -> str:
    """The values with their symbols."""
    return ", ".join(f"{QUANTITIES[name].symbol} = {_text(v)}" for name, v in values.items())


def _text(value: float) -> str:
    """A number, as a fraction of π if it is one."""
    part = Fraction(value / math.pi).limit_denominator(60)
    if value == 0 or not math.isclose(part * math.pi, value, rel_tol=1e-12):
        return f"{value:g}"
    above = {1: "", -1: "-"}.get(part.numerator, str(part.numerator))
    return f"{above}π" + (f"/{part.denominator}" if part.denominator > 1 else "")


def run_level(level: str, grid: Grid, store: Path | None, **settings: Any) -> Run:
    """Sweep the grid at one level; `settings` are those of `sweep`.

    Raises:
        ValueError: bad settings, or a store with something else in it.
    """

    def problem(**point: Any) -> tuple[Any, Any]:
        at = {name.replace("_", "-"): value for name, value in point.items()}
        return equation_at(level, at["delta"]), start(at)

    before = 0 if store is None else starts_done(store, settings.get("repair", False))
    try:
        with _compiling() as seconds:
            basin = sweep(problem, grid, store=store, **settings)
    except StoreMismatch as error:
        raise ValueError(f"{error.reason}; choose another --output, or remove it.") from None
    return Run(basin, store, before, seconds())


def repair(path: str, progress: bool) -> tuple[Run, int]:
    """Mend the store of a map, which holds all that its sweep needs; how many starts it took.

    Raises:
        ValueError: it is not the store of a map.
        StoreDamaged: its metadata are damaged.
    """
    whole = verify(path)
    tiles = open_store(path)
    attrs, axes = tiles.header["attrs"], tiles.header["axes"]
    level = [level.value for level in Level if level.label == attrs["level"]]
    names = {name.replace("_", "-") for name in axes}
    if not level or names not in ({"delta", "phi", *ways} for ways in (CYLINDRICAL, SPHERICAL)):
        must = "be the store of a `dipoletop map`"
        refuse("path", must, f"{path} is of another sweep, which repairs it with `repair=True`")
    settings = {name: attrs.get(name) for name in ("rtol", "max_steps", "confirm", "engine")}
    settings |= {"repair": True, "progress": level[0] if progress else False}
    grid = Grid(**{name: tiles.values(name) for name in axes})
    run = run_level(level[0], grid, tiles.folder, **settings)
    return run, sum(tiles.tiling.length(tile) for tile in (*whole.unfinished, *whole.damaged))


@contextlib.contextmanager
def _compiling() -> Iterator[Callable[[], float]]:
    """Measures for how long any thread traces or compiles: a function of the seconds."""
    spans: list[tuple[float, float]] = []

    def listen(event: str, duration_secs: float, **kwargs: Any) -> None:
        if event.startswith(("/jax/core/compile/", COMPILING)):
            now = time.perf_counter()
            spans.append((now - duration_secs, now))

    def union() -> float:
        total, end = 0.0, -math.inf
        for begin, until in sorted(spans):
            total += max(0.0, until - max(begin, end))
            end = max(end, until)
        return total

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        yield union
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)


def report(runs: list[Run]) -> str:
    """What the sweeps found, what they cost, and what they did not have to do."""
    columns = [_column(run) for run in runs]
    names = list(dict.fromkeys(name for column in columns for name in column))
    rows = [("", *(run.basin.level for run in runs))]
    rows += [(name, *(column.get(name, "—") for column in columns)) for name in names]
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]
    return "\n".join([*lines, "", *_remarks(runs)])


def _column(run: Run) -> dict[str, str]:
    basin, steps = run.basin, run.basin.steps
    size, outcome = steps.size, run.basin.outcome
    shares = {name.lower(): _percent(share) for name, share in basin.fractions().items()}
    column = {name: shares[name] for name in ("residual", "stop", *shares) if name in shares}
    known = (outcome == Outcome.RESIDUAL) | (outcome == Outcome.STOP)
    column["certified for its level"] = f"{np.mean(basin.certified):.2%} of the starts"
    unknown = (outcome == Outcome.RESIDUAL) & np.isnan(basin.omega_inf)
    if unknown.any():
        column["ω∞ not known"] = f"{np.sum(unknown)} residual starts: its error may exceed it"
    if "changed" in basin.columns:
        column["changed at second tolerance"] = f"{np.sum(basin.changed)} starts"
    new, seconds = size - run.before, basin.seconds - run.compiling
    if run.before:
        column["found in the store"] = f"{run.before} starts"
    if new:
        column["computed"] = f"{new} starts in {seconds:.1f} s"
        column["starts per second"] = f"{new / seconds:,.0f}"
        column["compilation, apart"] = f"{run.compiling:.1f} s"
        column["engine"] = ENGINES[basin.attrs["engine"]]
    column["decided at τ = 0"] = f"{np.sum(known & (steps == 0))} starts, without a step"
    column["steps"] = f"{np.mean(steps):.1f} on average, at most {np.max(steps)}"
    ended = basin.time[known]
    if ended.size:
        column["τ when certain"] = f"{np.median(ended):.3g} (median), at most {np.max(ended):.3g}"
    return column


def _percent(share: Share) -> str:
    return f"{share.share:.2%}  [{100 * share.low:.2f}, {100 * share.high:.2f}]"


def _remarks(runs: list[Run]) -> list[str]:
    lines = ["In brackets: 95 % intervals as for random starts."]
    if len(runs) == 2:
        first, second = (run.basin for run in runs)
        differ = int(np.sum(first.outcome != second.outcome))
        size = first.outcome.size
        lines.append(f"Outcome differs between the levels: {differ} starts, {differ / size:.2%}.")
    basin = runs[0].basin
    size, whole = math.prod(basin.shape), math.prod(unfold(basin).shape)
    if whole > size:
        lines.append(
            f"Not computed: {whole - size} of {whole} starts of the whole plane "
            f"({1 - size / whole:.0%}), which follow by symmetry."
        )
    lines.append(
        "Not integrated: whatever follows once outcome and ω∞ are certain (the settled tail)."
    )
    return lines
