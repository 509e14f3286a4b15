"""The rates of the torques on a particle, against pressure and against speed."""

from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .._base.checks import instance
from .._base.refusals import refuse
from ..surroundings import Balance
from .style import BLACK, BLUE, GREEN, MM, ORANGE, STYLE, WIDE

LINES = {"radiation": (ORANGE, "radiation"), "gas": (BLUE, "gas")}
LINES |= {"blackbody": (GREEN, "thermal radiation"), "field": (BLACK, "field, at most")}
DECADES = 3.0
"""Decades of pressure or speed on either side of what is marked."""


def balance(balance: Balance) -> Figure:
    """Plot the rates of all torques against the pressure, and against the speed of rotation.

    The present pressure and speed are marked by dots. A dashed line is the speed below which
    thermal rotation hides the motion, a dotted one the speed at which the stress reaches the
    strength.

    Args:
        balance: a single balance of a particle with a shape.

    Returns:
        The figure; `plots.save` writes it.

    Raises:
        ValueError: another argument, a batch, or a particle without a shape.
    """
    instance("balance", balance, Balance)
    if balance.omega.ndim > 1:
        refuse("balance", "be that of one rotation", f"has shape {balance.omega.shape[:-1]}")
    if balance.particle.shape is None:
        refuse("balance", "belong to a particle with a `shape`", "has none")
    rates = {name: float(balance.rates[name]) for name in LINES}
    gas: Any = next(each for each in balance.surroundings if each.name == "gas")
    pressure, equal = float(gas.pressure), float(balance.equal_pressure)
    speed = float(np.linalg.norm(balance.omega))
    with mpl.rc_context(STYLE):
        figure = Figure((WIDE, 75 * MM), layout="constrained")
        left, right = figure.subplots(1, 2, sharey=True)
        marks = [mark for mark in (pressure, equal) if mark > 0]
        p = np.geomspace(min(marks) / 10**DECADES, max(marks) * 10**DECADES, 200)
        per_pascal = rates["radiation"] / equal if equal > 0 else rates["gas"] / pressure
        _draw(left, p, rates, {"gas": per_pascal * p})
        left.set(xlabel="pressure (Pa)", ylabel="rate of the angular momentum (1/s)")
        w = np.geomspace(speed / 10**DECADES, speed * 10**DECADES, 200)
        slope = w / speed
        rising = {"radiation": rates["radiation"] * slope**2, "field": rates["field"] / slope}
        _draw(right, w, rates, rising)
        right.set_xlabel("angular speed (rad/s)")
        right.axvline(float(balance.thermal_spin), color=BLACK, lw=0.8, ls="--")
        if np.isfinite(balance.strength):
            bursts = speed * np.sqrt(float(balance.strength / balance.stress))
            right.axvline(bursts, color=BLACK, lw=0.8, ls=":")
        for name, rate in rates.items():
            colour, _ = LINES[name]
            if rate > 0:
                right.plot(speed, rate, "o", color=colour, ms=4)
                if pressure > 0:
                    left.plot(pressure, rate, "o", color=colour, ms=4)
        left.legend()
        right.set_xlim(w[0], w[-1])
        left.set_title(f"at {speed:.3g} rad/s")
        right.set_title(f"at {pressure:.3g} Pa")
    return figure


def _draw(ax: Axes, x: Any, rates: dict[str, float], rising: dict[str, Any]) -> None:
    """Draw the rates that are known; those not in `rising` are constant."""
    for name, (colour, label) in LINES.items():
        values = rising.get(name, np.full_like(x, rates[name]))
        if np.any(values > 0):
            ax.plot(x, values, color=colour, label=label)
    ax.set(xscale="log", yscale="log", xlim=(x[0], x[-1]))
