"""The texts of the page, in HTML."""

import math
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

import numpy as np

from .._base.numerals import as_text
from .._base.summaries import with_error
from .._base.types import Regime
from ..equations.levels import Level
from ..plots.style import capitalised, percent
from .pictures import Picture, colour_scale, shares
from .scenes import Scene
from .starts import ShownMotion, StartVerdict
from .views import View

CSS = Path(__file__).with_name("page.css").read_text(encoding="utf-8")
"""The style of these texts."""
THEME, DARK = "theme", "dark"
"""The name in an address, and the value, that ask for a dark page."""
HEAD = """
<h1 class="dt-head">How a rotating dipole ends</h1>
<p class="dt-help">Every point of the map is a start of the body. From a black one it stops; a
colour is the rotation ω∞ that it keeps. Click a start to see its motion; scroll to zoom, drag to
move: the map is computed again there.</p>
"""
SHAPES = 5
"""Number of bodies drawn along the slider of δ."""
LAWS = {
    Regime.RESOLVED: "integrated",
    Regime.SLOW_FLOW: "predicted by the average over free rotation",
    Regime.AVERAGED: "predicted by the average over free rotation",
    Regime.UNFOLDED: "predicted by the limit of small amplitudes",
    Regime.EXACT: "exact",
}


def scale(name: str, low: float, high: float) -> str:
    """Return the ends of a slider; between them, for δ, bodies of these shapes (figure 1)."""
    places = [low, *(np.linspace(low, high, SHAPES)[1:-1] if name == "delta" else ()), high]
    marks = [outline(float(place)) if name == "delta" else "" for place in places]
    ends = [shown(low), *("" for _ in places[1:-1]), shown(high)]
    cells = (f"<span>{mark}{end}</span>" for mark, end in zip(marks, ends, strict=True))
    return f'<div class="dt-ends">{"".join(cells)}</div>'


def outline(delta: float) -> str:
    """Return the outline of a homogeneous spheroid with δ = 1 − I₃/I₁, its symmetry axis upright.

    I₃/I₁ = 2a²/(a² + c²), so that the half-axes have the ratio c/a = √((1 + δ)/(1 − δ)).
    """
    along, across = math.sqrt(max(1 + delta, 0.0)), math.sqrt(max(1 - delta, 0.0))
    most = max(along, across)
    along, across = (max(8 * half / most, 0.8) for half in (along, across))
    return (
        '<svg viewBox="-9 -9 18 18" role="img" aria-label="shape">'
        f'<ellipse rx="{across:.2f}" ry="{along:.2f}"/></svg>'
    )


def legend(picture: Picture) -> str:
    """Return the legend: colours and names of the classes that occur, and the scale of ω∞."""
    names = dict(picture.legend)
    if picture.scale:  # the scale shows both signs
        names.pop("residual, ω∞ > 0", None)
        names.pop("residual, ω∞ < 0", None)
    parts = [
        f'<span class="dt-class"><i style="background:{colour}"></i>{escape(name)}</span>'
        for name, colour in names.items()
    ]
    if picture.differs is not None:
        parts.append('<span class="dt-class"><i class="dt-hatch"></i>outcome differs</span>')
    if picture.scale:
        stops = ", ".join(colour_scale())
        parts.append(
            f'<span class="dt-scale">residual, ω∞ = {minus(f"{-picture.scale:g}")}'
            f'<b style="background:linear-gradient(to right, {stops})"></b>{picture.scale:g}</span>'
        )
    return f'<div class="dt-legend">{"".join(parts)}</div>'


def caption(picture: Picture, number: int) -> str:
    """Return the caption of a map: its level with the caveat, and the shares of the outcomes."""
    levels = picture.view.levels
    basin = picture.basins[number]
    level = levels[number] if levels else None
    lines = [f"<b>{escape(capitalised(basin.level))}</b>", escape(shares(basin))]
    if isinstance(level, Level) and level.caveat:
        lines.insert(1, f'<span class="dt-caveat">{escape(level.caveat)}.</span>')
    return f'<div class="dt-caption">{"<br>".join(lines)}</div>'


def status(scene: Scene, picture: Picture, ended: Sequence[str]) -> str:
    """Return the fixed values, the number of starts, and what limits the resolution."""
    view, symbols = picture.view, scene.symbols
    fixed = ", ".join(f"{symbols[name]} = {shown(x)}" for name, x in view.fixed.items())
    size = f"{picture.size} × {picture.size} starts"
    lines = [f"{fixed}; {size}" if fixed else size]
    lines[0] += "" if picture.is_final else " at first, finer ones follow …"
    if picture.differs is not None:
        lines.append(f"The outcome differs for {percent(picture.differs)} of the starts.")
    lines += [_end_of_zoom(view, name, symbols[name]) for name in ended]
    if not ended and (fine := _finer_than_tolerance(view, symbols)):
        lines.append(fine)
    return f'<div class="dt-status" aria-live="polite">{"<br>".join(lines)}</div>'


def _end_of_zoom(view: View, name: str, symbol: str) -> str:
    low, high = view.ranges[name]
    return (
        f'<span class="dt-caveat">Rounding ends the zoom in {escape(symbol)} here: neighbouring '
        f"starts differ by {(high - low) / view.size:.1e}, and closer ones could not be "
        "distinguished.</span>"
    )


def _finer_than_tolerance(view: View, symbols: Mapping[str, str]) -> str:
    """Return a warning where pixels are closer than the tolerance."""
    for name, (low, high) in view.ranges.items():
        step = (high - low) / view.size
        if step < view.rtol * max(abs(low), abs(high)):
            return (
                f"Neighbouring starts differ in {escape(symbols[name])} by {step:.1e}, less than "
                "the tolerance: labels next to a boundary are uncertain. A smaller rtol helps."
            )
    return ""


def verdicts(scene: Scene, values: Mapping[str, float], found: Sequence[StartVerdict]) -> str:
    """Return the start, and how it ends at each level."""
    start = ", ".join(f"{escape(scene.symbols[name])} = {shown(x)}" for name, x in values.items())
    return f'<h3>Start</h3><p class="dt-status">{start}</p>' + "".join(map(_verdict, found))


def _verdict(verdict: StartVerdict) -> str:
    rows = {"outcome": verdict.outcome, "law": LAWS[verdict.regime]}
    if 0 < verdict.probability < 1:
        rows["probability of residual rotation"] = f"{verdict.probability:.4g}"
    if verdict.outcome.startswith("residual"):
        known = math.isfinite(verdict.omega_inf)
        value = with_error(verdict.omega_inf, verdict.omega_inf_error) if known else "not known"
        rows["ω∞ = τ₀Ω∞"] = minus(value)
    if math.isfinite(verdict.time):
        rows["certain at τ"] = f"{verdict.time:.4g}, after {verdict.steps} steps"
    rows["certified for this level"] = "yes" if verdict.certified else "no"
    return f"<h4>{escape(capitalised(verdict.level))}</h4>{_table(rows)}"


def length_of(motion: ShownMotion) -> str:
    """Return a note if a motion is shown only until before its outcome is decided; "" otherwise."""
    if not motion.is_cut:
        return ""
    return (
        f'<p class="dt-caveat">The motion is shown until τ = {motion.ts[-1]:.4g}, before its '
        "outcome is decided: it turns too often to show more.</p>"
    )


def slopes(scene: Scene, level: str, found: Mapping[str, float]) -> str:
    """Return the derivatives of ω∞ at a start."""
    rows = {f"∂ω∞/∂{scene.symbols[name]}": _slope(value) for name, value in found.items()}
    return f"<h4>Derivatives of ω∞, {escape(level)}</h4>{_table(rows)}"


def _slope(value: float) -> str:
    if math.isnan(value):
        return "none, or not known"
    return "infinite" if abs(value) > 1e300 else minus(f"{value:.6g}")


def _table(rows: Mapping[str, str]) -> str:
    cells = (f"<tr><th>{escape(name)}</th><td>{escape(x)}</td></tr>" for name, x in rows.items())
    return f'<table class="dt-table">{"".join(cells)}</table>'


def waiting(what: str) -> str:
    """Return a note that something is being computed."""
    return f'<p class="dt-waiting">{escape(what)}: computing …</p>'


def refused(sentence: str) -> str:
    """Return a message of refusal as HTML."""
    return f'<p class="dt-refused" role="alert">{escape(sentence)}</p>'


def shown(value: float) -> str:
    """Return a number as text, with a minus sign that is none of a hyphen."""
    return minus(as_text(value))


def minus(text: str) -> str:
    """Return a text of numbers with minus signs in place of hyphens."""
    return text.replace("-", "−")


def code(text: str, address: str) -> str:
    """Return the script that reproduces a view, and its address."""
    link = f'<a href="{escape(address)}" target="_blank">address of this view</a>'
    return f'<pre class="dt-code">{escape(text)}</pre><p>{link}</p>'
