"""What `dipoletop simulate` prints of a run: states, its end, what another level says."""

import math
from typing import Any

from .._base.types import Outcome, Stop
from .._runs.classify import classify
from ..equations.levels import CONSISTENT, LACKS
from ..equations.transverse import equation_at


def states(rows: Any) -> str:
    """The start, and every tenfold time up to the end."""
    last = len(rows) - 1
    shown = sorted({0, *(max(1, round(last / 10**k)) for k in range(4))})
    lines = [f"{'τ':>10} {'ω₁':>16} {'ω₂':>16} {'ω₃':>16} {'energy':>12} {'power':>12}"]
    for tau, *omega, energy, power in rows[shown]:
        states = " ".join(f"{value:16.9e}" for value in omega)
        lines.append(f"{tau:10g} {states} {energy:12.5e} {power:12.5e}")
    return "\n".join(lines)


def ending(verdict: Any) -> str:
    """How the run ended, and ω∞."""
    outcome = Outcome(int(verdict.outcome))
    if outcome == Outcome.FAILED:
        return "Outcome: failed, the state is not a number."
    if outcome == Outcome.UNDECIDED:
        return (
            f"Outcome: undecided after {int(verdict.steps)} steps, τ = {float(verdict.time):.6g}."
        )
    if verdict.certified:
        proof = "certified: in a region proven to decide for this level of the equation"
    else:
        proof = "not certified: in a region tested, not proven, to decide"
    return (
        f"Outcome: {_fate(verdict)}; {proof}, at τ = {float(verdict.time):.6g}.\n"
        f"Residual angular velocity ω∞ = {_rotation(verdict)}"
    )


def _rotation(verdict: Any) -> str:
    """ω∞, to the digits that its estimated error leaves."""
    value, error = float(verdict.omega_inf), float(verdict.omega_inf_error)
    if not math.isfinite(value):
        return "not known: its estimated error exceeds it (a smaller --rtol may tell)"
    if value == 0:
        return "0"
    digits = max(2, min(16, math.ceil(math.log10(abs(value) / error)) + 1)) if error else 16
    return f"{value:.{digits}g} ± {error:.1g}"


def _fate(verdict: Any) -> str:
    """How a run ended, in words."""
    outcome, kind = Outcome(int(verdict.outcome)), Stop(int(verdict.stop))
    names = {Outcome.STOP: "stop", Outcome.RESIDUAL: "residual rotation"}
    text = names.get(outcome, outcome.name.lower())
    return text if kind == Stop.NONE else f"{text} ({kind.name.lower()})"


def by_consistent(delta: float, start: Any, settings: dict[str, Any]) -> str:
    """What the consistent level says of a start whose result is of order 1."""
    equation = equation_at(CONSISTENT, delta)
    verdict = classify(equation, start, **settings)
    value = f"{_fate(verdict)}, ω∞ = {_rotation(verdict)}"
    return f"{LACKS}; at the {equation.level} level this start ends so: {value}."
