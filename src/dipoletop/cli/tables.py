"""The tables and sentences that the command line prints."""

import dataclasses
import math
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Array, Complex, Float

from .._base.summaries import with_error
from .._base.types import Outcome, Regime, Stop
from .._maps.unfolded_basins import unfold
from .._runs.classification import Classification
from ..equations.levels import Level
from ..stability import Spectrum
from ..validation import Check
from .maps import Run

if TYPE_CHECKING:
    from ..paper import Entry

ENGINES = {"native": "native (machine code)", "jax": "JAX"}
PREDICTED = {
    Regime.SLOW_FLOW: "predicted by the slow flow",
    Regime.AVERAGED: "predicted by the averaged top",
    Regime.UNFOLDED: "predicted by the law of capture",
    Regime.EXACT: "predicted in closed form",
}
OUTCOMES = {Outcome.RESIDUAL: "residual rotation", Outcome.STOP: "stop"}


def checks(results: Iterable[Check]) -> Iterator[tuple[str, bool]]:
    """The lines of `dipoletop validate`, each with whether its check passed."""
    yield f"{'check':46} {'expected':>20} {'found':>20} {'error':>8} {'allowed':>8}", True
    for check in results:
        line = (
            f"{check.name:46} {check.expected:20.12g} {check.found:20.12g} "
            f"{check.error:8.1e} {check.tolerance:8.1e} {'ok' if check.passed else 'FAILED'}"
        )
        yield line, check.passed


def ledger(entries: "Iterable[Entry]") -> Iterator[tuple[str, bool]]:
    """The lines of `dipoletop validate --paper`, each with whether its claim holds."""
    columns = "{:9}  {:24}  {:>8}  {:>8}  {}"
    yield columns.format("verdict", "where in the paper", "residual", "allowed", "what holds"), True
    for entry in entries:
        residual, limit = f"{entry.residual:.1e}", f"{entry.limit:.1e}"
        yield columns.format(entry.verdict, entry.place, residual, limit, entry.claim), entry.holds
        if entry.printed:
            residual = f"{entry.printed_residual:.1e}"
            yield columns.format("", "  the paper has:", residual, "", entry.printed), True


def spectrum(level: str, spectrum: Spectrum) -> list[str]:
    """The lines of `dipoletop spectrum` for one level."""
    lines = [
        f"{level}: {'stable' if spectrum.stable else 'not stable'}",
        f"  slow      {_complex_numbers(spectrum.slow)}",
    ]
    if spectrum.fast.size:
        lines.append(f"  runaways  {_complex_numbers(spectrum.fast)}")
    back, reactivity = float(spectrum.return_time), float(spectrum.reactivity)
    return [*lines, f"  return time {back:.6g}, reactivity {reactivity:.6g}"]


def _complex_numbers(values: Complex[Array, "n"]) -> str:
    """The numbers, with their imaginary parts where these are not 0."""
    texts = []
    for value in np.asarray(values).tolist():
        text = f"{value.real:.10g}"
        texts.append(text + (f"{value.imag:+.10g}i" if value.imag else ""))
    return "   ".join(texts)


def states(rows: Float[np.ndarray, "T 6"]) -> str:
    """τ, ω, energy and power at the start, and at every tenfold time up to the end."""
    last = len(rows) - 1
    shown = sorted({0, *(max(1, round(last / 10**k)) for k in range(4))})
    lines = [f"{'τ':>10} {'ω₁':>16} {'ω₂':>16} {'ω₃':>16} {'energy':>12} {'power':>12}"]
    for tau, *omega, energy, power in rows[shown]:
        components = " ".join(f"{value:16.9e}" for value in omega)
        lines.append(f"{tau:10g} {components} {energy:12.5e} {power:12.5e}")
    return "\n".join(lines)


def ending(result: Classification) -> str:
    """How a run ended, and its ω∞."""
    outcome = Outcome(int(result.outcome))
    if outcome == Outcome.FAILED:
        return "Outcome: failed, the state is not a number."
    if outcome == Outcome.UNDECIDED:
        if result.regime:
            chance = f"residual with probability {float(np.asarray(result.probability)):.4g}"
            return f"Outcome: undecided, a matter of chance: {chance}."
        return f"Outcome: undecided after {int(result.steps)} steps, τ = {float(result.time):.6g}."
    if np.isnan(result.time):
        return (
            f"Outcome: {_outcome(result)}; predicted by the average over free rotation.\n"
            f"Residual angular velocity ω∞ = {_omega_inf(result)}"
        )
    if result.certified:
        proof = "certified: in a region proven to decide for this level of the equation"
    else:
        proof = "not certified: in a region tested, not proven, to decide"
    return (
        f"Outcome: {_outcome(result)}; {proof}, at τ = {float(result.time):.6g}.\n"
        f"Residual angular velocity ω∞ = {_omega_inf(result)}"
    )


def other_ending(level: str, result: Classification) -> str:
    """How the same start ends at a consistent level, beside a result of order 1."""
    value = f"{_outcome(result)}, ω∞ = {_omega_inf(result)}"
    return f"{Level.ORDER_1.caveat}; at the {level} level this start ends so: {value}."


def _outcome(result: Classification) -> str:
    """How a run ended, in words."""
    outcome, stop = Outcome(int(result.outcome)), Stop(int(result.stop))
    text = OUTCOMES.get(outcome, outcome.name.lower())
    return text if stop == Stop.NONE else f"{text} ({stop.name.lower()})"


def _omega_inf(result: Classification) -> str:
    """ω∞, to the digits that its estimated error leaves."""
    value, error = float(result.omega_inf), float(result.omega_inf_error)
    if not math.isfinite(value):
        if result.regime:
            return "not known: its sign is a matter of chance"
        return "not known: its estimated error exceeds it (a smaller --rtol may tell)"
    if value == 0:
        return "0"
    return with_error(value, error)


def maps(runs: list[Run]) -> str:
    """What the sweeps of a map gave, what they cost, and what they did not have to do."""
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
    """The cells of one level, by the names of their rows."""
    basin, steps = run.basin, run.basin.steps
    size, outcome = steps.size, run.basin.outcome
    shares = {name.lower(): f"{share.share:.2%}" for name, share in basin.fractions().items()}
    column = {name: shares[name] for name in ("residual", "stop", *shares) if name in shares}
    decided = (outcome == Outcome.RESIDUAL) | (outcome == Outcome.STOP)
    column["certified for its level"] = f"{np.mean(basin.certified):.2%} of the starts"
    unknown = (outcome == Outcome.RESIDUAL) & np.isnan(basin.omega_inf)
    if unknown.any():
        resolved = np.sum(unknown & (basin.regime == Regime.RESOLVED))
        by_chance = np.sum(unknown) - resolved
        reasons = {"its error may exceed it": resolved, "its sign is a matter of chance": by_chance}
        shown = (f"{count} residual starts: {why}" for why, count in reasons.items() if count)
        column["ω∞ not known"] = "; ".join(shown)
    regimes = basin.regime
    for regime in Regime:
        if regime != Regime.RESOLVED and (count := np.sum(regimes == regime)):
            column[PREDICTED[regime]] = f"{count} starts"
    chance = basin.probability[outcome == Outcome.UNDECIDED]
    if (chance := chance[np.isfinite(chance)]).size:
        mean = f"residual with probability {np.mean(chance):.3f} on average"
        column["a matter of chance"] = f"{chance.size} undecided starts, {mean}"
    if "changed" in basin.columns:
        column["changed at second tolerance"] = f"{np.sum(basin.changed)} starts"
    computed, seconds = size - run.stored, basin.seconds - run.compiling
    if run.stored:
        column["found in the store"] = f"{run.stored} starts"
    if computed:
        column["computed"] = f"{computed} starts in {seconds:.1f} s"
        column["starts per second"] = f"{computed / seconds:,.0f}"
        column["compilation, apart"] = f"{run.compiling:.1f} s"
        column["engine"] = ENGINES[basin.attrs["engine"]]
    time = basin.time
    at_once = decided & (time == 0)
    column["decided at τ = 0"] = f"{np.sum(at_once)} starts, without a step"
    column["steps"] = f"{np.mean(steps):.1f} on average, at most {np.max(steps)}"
    times = time[decided & ~np.isnan(time)]
    if times.size:
        column["τ when certain"] = f"{np.median(times):.3g} (median), at most {np.max(times):.3g}"
    return column


def _remarks(runs: list[Run]) -> list[str]:
    """What the table leaves out: the comparison, and what was not computed."""
    lines = []
    if len(runs) == 2:
        first, second = (run.basin.outcome for run in runs)
        differ = int(np.sum(first != second))
        share = differ / first.size
        lines.append(f"Outcome differs between the levels: {differ} starts, {share:.2%}.")
    basin = runs[0].basin
    shape = unfold(dataclasses.replace(basin, columns={})).shape
    size, whole = math.prod(basin.shape), math.prod(shape)
    if whole > size:
        lines.append(
            f"Not computed: {whole - size} of {whole} starts of the whole plane "
            f"({1 - size / whole:.0%}), which follow by symmetry."
        )
    lines.append(
        "Not integrated: whatever follows once outcome and ω∞ are certain (the settled tail)."
    )
    return lines
