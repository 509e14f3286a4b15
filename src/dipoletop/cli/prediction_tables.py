"""What `dipoletop predict` prints: a table of one rotation, or of many directions of L."""

import math
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from .._base.types import Outcome, Regime
from ..prediction import ENDS, Prediction

if TYPE_CHECKING:
    from ..particles import Particle

SHOWN = (0.1, 0.5, 0.9)
"""The quantiles over directions."""
WEIGHTS = np.array([0.15, 0.225, 0.25, 0.225, 0.15])
"""The share of chance that each of the `QUANTILES` .05, .25, .5, .75, .95 stands for: it reaches
halfway to the next ones."""
OUTCOMES = {
    Outcome.RESIDUAL: "residual rotation",
    Outcome.STOP: "stop",
    Outcome.UNDECIDED: "a matter of chance",
    Outcome.FAILED: "failed",
}
LAWS = {
    Regime.RESOLVED: "integration turn by turn",
    Regime.SLOW_FLOW: "slow flow, averaged over free rotation",
    Regime.AVERAGED: "slow flow of an axisymmetric body",
    Regime.UNFOLDED: "small amplitudes of a nearly axisymmetric body",
    Regime.EXACT: "exact solution",
}
UNITS = (("years", 365.25 * 86400), ("days", 86400.0), ("hours", 3600.0))
NAME_WIDTH, WIDTH = 18, 11


def particle(particle: "Particle") -> str:
    """The particle and its dipole, in principal axes."""
    from ..particles import DEBYE

    inertia, dipole = np.asarray(particle.inertia), np.asarray(particle.dipole)
    unit = np.trace(inertia)
    moments, axes = np.linalg.eigh(inertia / unit)
    size = np.linalg.norm(dipole)
    cosines = np.abs(axes.T @ (dipole / size))
    shown = ", ".join(f"{0.0 if cosine < 1e-12 else cosine:.4g}" for cosine in cosines)
    return (
        f"mass {float(particle.mass):.4g} kg, J₃ = {moments[2] * unit:.4g} kg m², "
        f"J₁/J₃ = {moments[0] / moments[2]:.4g}, J₂/J₃ = {moments[1] / moments[2]:.4g}\n"
        f"dipole {size / DEBYE:.4g} D, its cosines with the axes of J₁, J₂, J₃: {shown}"
    )


def one(prediction: Prediction) -> str:
    """The table of one rotation."""
    energy = _energies(np.asarray(prediction.variables)[None])[0]
    ratio = float(prediction.ratio)
    outcome = Outcome(int(prediction.outcome))
    rows = {
        "outcome": OUTCOMES[outcome],
        "ends": _ends(np.asarray(prediction.probability)),
        "L∞/L₀": f"{ratio:.6g}" if outcome != Outcome.FAILED else "not known",
    }
    quantiles = np.asarray(prediction.ratio_quantiles)
    if quantiles[0] < quantiles[-1]:
        rows["L∞/L₀"] += " (mean); 5 … 95 %: " + ", ".join(f"{q:.3g}" for q in quantiles)
    rows |= {
        "ω∞": _speed(float(prediction.omega_inf)),
        "half time": duration(float(prediction.half_time)),
        "lifetime": duration(float(prediction.lifetime)),
        "radiated energy": f"{float(prediction.radiated_energy):.4g} J, "
        f"{float(prediction.radiated_energy) / energy:.3%} of E₀",
        "law": LAWS[Regime(int(prediction.regime))],
        "relative error": f"{float(prediction.error):.1g} (estimated)",
    }
    return "\n".join(f"{name:{NAME_WIDTH}}{value}" for name, value in rows.items())


def many(predictions: Prediction) -> str:
    """The table of one particle and many directions of L."""
    weights = np.ones(predictions.outcome.shape)
    ratios = np.asarray(predictions.ratio_quantiles)
    energies = _energies(np.asarray(predictions.variables))
    pooled = np.broadcast_to(WEIGHTS, ratios.shape)
    columns = ("mean", *(f"{share:.0%}".replace("%", " %") for share in SHOWN))
    radiated = np.asarray(predictions.radiated_energy)
    lines = [
        f"{'':{NAME_WIDTH}}" + "".join(f"{name:>{WIDTH}}" for name in columns),
        _row("L∞/L₀", ratios, pooled, float(np.mean(predictions.ratio))),
        *_times("half time", np.asarray(predictions.half_time)),
        *_times("lifetime", np.asarray(predictions.lifetime)),
        _row("radiated, J", radiated, weights, float(np.mean(radiated))),
        _row("    share of E₀", radiated / energies, weights, float(np.mean(radiated / energies))),
        "",
    ]
    outcomes = np.asarray(predictions.outcome)
    shares = [
        f"{_percent(np.mean(outcomes == outcome))} {word}"
        for outcome, word in OUTCOMES.items()
        if np.any(outcomes == outcome)
    ]
    ends = _ends(np.mean(np.asarray(predictions.probability), axis=0))
    laws = [LAWS[Regime(int(law))] for law in np.unique(np.asarray(predictions.regime))]
    rows = {
        "outcome": ", ".join(shares),
        "ends": ends,
        "law": "; ".join(laws),
        "relative error": f"{np.max(np.asarray(predictions.error)):.1g} (estimated), at most",
    }
    return "\n".join([*lines, *(f"{name:{NAME_WIDTH}}{text}" for name, text in rows.items())])


def _times(name: str, seconds: Float[np.ndarray, "N"]) -> list[str]:
    """Two rows, in seconds and in years; one if all times are infinite, or unknown."""
    if not np.any(np.isfinite(seconds)):
        return [f"{name:{NAME_WIDTH}}{'∞' if np.all(np.isinf(seconds)) else 'not known':>{WIDTH}}"]
    weights = np.ones(seconds.shape)
    return [
        _row(f"{name}, s", seconds, weights, None),
        _row("        in years", seconds / UNITS[0][1], weights, None),
    ]


def _row(
    name: str,
    values: Float[np.ndarray, "..."],
    weights: Float[np.ndarray, "..."],
    mean: float | None,
) -> str:
    """A row of the table: the mean, if it says anything, and the quantiles."""
    cells = ["—" if mean is None else _cell(mean)]
    cells += [_cell(value) for value in quantiles_of(values, weights)]
    return f"{name:{NAME_WIDTH}}" + "".join(f"{cell:>{WIDTH}}" for cell in cells)


def quantiles_of(
    values: Float[np.ndarray, "..."], weights: Float[np.ndarray, "..."]
) -> list[float]:
    """The `SHOWN` quantiles of values with weights; NaN where values that are not known matter."""
    order = np.argsort(values, axis=None)  # NaN last
    ranked, weights = np.ravel(values)[order], np.ravel(weights)[order] / np.sum(weights)
    if np.isnan(ranked[0]):
        return [math.nan] * len(SHOWN)
    share = np.cumsum(weights)
    between = np.interp(SHOWN, share - weights / 2, ranked)
    # Nothing lies between a number and infinity: there it is the value that reaches the share.
    reached = ranked[np.searchsorted(share, np.array(SHOWN) - 1e-12)]
    return np.where(np.isfinite(between), between, reached).tolist()


def _cell(value: float) -> str:
    if math.isnan(value):
        return "—"
    return "∞" if math.isinf(value) else f"{value:.3g}"


def _energies(variables: Float[np.ndarray, "N 15"]) -> Float[np.ndarray, "N"]:
    """E₀ = Ω·IΩ/2 of every start."""
    omega = variables[:, 12:]
    return np.sum(omega @ variables[0, :9].reshape(3, 3) * omega, axis=1) / 2


def _ends(probability: Float[np.ndarray, "8"]) -> str:
    """The ends that may happen, with their probabilities."""
    known = [(float(p), end) for p, end in zip(probability, ENDS, strict=True) if p > 0]
    return ", ".join(f"{_percent(p)} {end.replace('-', '−')}" for p, end in known) or "not known"


def _percent(share: float) -> str:
    return f"{100 * share:.3g} %"


def _speed(value: float) -> str:
    if math.isnan(value):
        return "not known: its sign is a matter of chance"
    return f"{value:.6g} rad/s" if value else "0"


def duration(seconds: float) -> str:
    """A time in seconds, and in years, days or hours where it is long."""
    if math.isnan(seconds):
        return "not known"
    if math.isinf(seconds):
        return "∞"
    for name, length in UNITS:
        if seconds >= length:
            return f"{seconds:.4g} s, {seconds / length:.3g} {name}"
    return f"{seconds:.4g} s"
