"""The motion from a start: ω and the energy against τ, and the body in the laboratory."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import panel as pn
from bokeh.models import CustomJS, Range1d
from bokeh.plotting import figure
from jaxtyping import Float

from ..plots.style import BLACK, BLUE, GREEN, ORANGE
from .pieces import pane_of, source, wide_figure
from .starts import FRAMES, OfBody, ShownMotion
from .texts import DARK

HEIGHT, WHITE = 250, "#e0e0e0"
CURVES = ("size", "|ω|", None), ("w1", "ω₁", BLUE), ("w2", "ω₂", ORANGE), ("w3", "ω₃", GREEN)
MERIDIANS, PARALLELS, POINTS = 8, 5, 24
"""Numbers of lines on the surface of a body, and of segments of each."""
DRAW = Path(__file__).with_name("motion.js").read_text(encoding="utf-8")
MESH = "x0", "y0", "z0", "x1", "y1", "z1"
PARTS = {"beginning": slice(0, FRAMES), "end": slice(-FRAMES, None)}
"""The two groups of pictures of the moving body."""


class CurvePlots:
    """Figures of a motion, empty until one is shown."""

    def __init__(self) -> None:
        self._omega = source("omega", "tau", "w1", "w2", "w3", "size")
        self._energy = source("energy", "tau", "energy")
        self._motion: ShownMotion | None = None
        ink = WHITE if pn.config.theme == DARK else BLACK
        of_omega = _figure("ω = τ₀Ω", "omega-figure")
        for column, name, colour in CURVES:
            style = {"color": colour or ink, "line_width": 1.5, "legend_label": name}
            of_omega.line("tau", column, source=self._omega, **style)
        of_omega.legend.orientation = "horizontal"
        of_omega.legend.padding = 2
        of_omega.legend.background_fill_alpha = 0.7
        of_energy = _figure("energy", "energy-figure", y_axis_type="log")
        self._ranges = of_omega.x_range, of_omega.y_range, of_energy.y_range
        of_energy.x_range = of_omega.x_range
        of_energy.line("tau", "energy", source=self._energy, color=ink, line_width=1.5)
        self.omega, self.energy = pane_of(of_omega), pane_of(of_energy)
        self.omega.visible = self.energy.visible = False
        self._body = _Body()
        self._part = pn.widgets.RadioButtonGroup(
            name="part", options=list(PARTS), value="beginning", width=200
        )
        self._part.param.watch(lambda _: self._show_body(), "value")
        self.body = pn.Column(self._part, self._body.pane, self._body.player, visible=False)

    @property
    def panes(self) -> list[Any]:
        """The panes of the figures."""
        return [self.omega, self.energy, self._body.pane]

    def show(self, motion: ShownMotion) -> None:
        """Draw a motion."""
        self._motion = motion
        size = np.linalg.norm(motion.omega, axis=1)
        w1, w2, w3 = motion.omega.T
        self._omega.data = {"tau": motion.ts, "w1": w1, "w2": w2, "w3": w3, "size": size}
        times, omegas, energies = self._ranges
        most = 1.05 * float(np.max(size)) or 1.0
        _set_range(times, 0.0, float(motion.ts[-1]))
        _set_range(omegas, min(1.05 * float(np.min(motion.omega)), -0.02 * most), most)
        self.omega.visible = True
        self.energy.visible = self.body.visible = motion.of_body is not None
        if motion.of_body is not None:
            energy = motion.of_body.energy
            shown = np.where(energy > 0, energy, np.nan)  # on a logarithmic scale
            if energy[0] > 0:
                _set_range(energies, float(np.nanmin(shown)) / 1.5, 1.5 * float(np.nanmax(shown)))
            self._energy.data = {"tau": motion.ts, "energy": shown}
        self._show_body()

    def pause(self) -> None:
        """Let the body stand still: drawing it takes the browser as long as drawing a map."""
        self._body.player.direction = 0

    def _show_body(self) -> None:
        motion = self._motion
        if motion is not None and motion.of_body is not None:
            self._body.show(motion, motion.of_body, PARTS[self._part.value])


class _Player(pn.widgets.Player):
    """A player whose frames only the browser counts: the server has no use for them."""

    @property
    def _linked_properties(self) -> tuple[str, ...]:
        return tuple(name for name in super()._linked_properties if name != "value")


class _Body:
    """A moving picture of the body, drawn in the browser."""

    def __init__(self) -> None:
        columns = "tau", "q0", "q1", "q2", "q3", "w1", "w2", "w3", "speed"
        self._frames = source("frames", *columns)
        self._mesh = source("mesh", *MESH)
        lines = source("lines", "x0", "y0", "x1", "y1", "alpha")
        arrows = source("arrows", "x0", "y0", "x1", "y1", "color")
        tips, trail = source("tips", "x", "y", "text", "color"), source("trail", "x", "y")
        plot: Any = figure(
            name="body-figure",
            height=330,
            width=330,
            x_range=Range1d(start=-1.75, end=1.75),
            y_range=Range1d(start=-1.75, end=1.75),
            tools="",
            toolbar_location=None,
            title="the body in the laboratory",
        )
        plot.axis.visible = plot.grid.visible = False
        ends = "x0", "y0", "x1", "y1"
        plot.segment(*ends, source=lines, color=GREEN, alpha="alpha")
        plot.line("x", "y", source=trail, color=ORANGE, alpha=0.5)
        plot.segment(*ends, source=arrows, color="color", line_width=4, line_cap="round")
        font = {"text_color": "color", "text_font_style": "bold", "text_align": "center"}
        plot.text("x", "y", "text", source=tips, text_baseline="middle", **font)
        self.player = _Player(
            start=0,
            end=FRAMES - 1,
            interval=60,
            loop_policy="loop",
            show_loop_controls=False,
            width=330,
            visible_buttons=["first", "previous", "pause", "play", "next", "last"],
        )
        self._dipole = source("dipole", "direction")
        drawn = {"frames": self._frames, "mesh": self._mesh, "lines": lines, "arrows": arrows}
        drawn |= {"tips": tips, "trail": trail, "direction": self._dipole, "title": plot.title}
        code = "const dipole = direction.data.direction\n" + DRAW
        self._frames.js_on_change("data", CustomJS(args=drawn, code="const k = 0\n" + code))
        self.player.jscallback(args=drawn, value="const k = cb_obj.value\n" + code)
        self.pane = pn.pane.Bokeh(plot)

    def show(self, motion: ShownMotion, of_body: OfBody, part: slice) -> None:
        """Show a part of a motion."""
        self._mesh.data = dict(zip(MESH, surface(np.asarray(of_body.inertia)), strict=True))
        self._dipole.data = {"direction": of_body.dipole / np.linalg.norm(of_body.dipole)}
        self.player.value = 0
        q, w = of_body.attitude[part].T, motion.omega[part].T
        columns = {f"q{k}": q[k] for k in range(4)} | {f"w{k + 1}": w[k] for k in range(3)}
        speed = np.linalg.norm(motion.omega[part], axis=1)
        self.player.direction = 1  # it turns at once
        self._frames.data = {"tau": motion.ts[part], **columns, "speed": speed}


def surface(inertia: Float[np.ndarray, "3 3"]) -> tuple[Float[np.ndarray, "n"], ...]:
    """Return segments of lines on the homogeneous ellipsoid with these moments, scaled to size 1.

    Its longest half-axis is 1.

    Returns:
        x, y and z, in body axes, where the segments begin, and where they end.
    """
    moments, axes = np.linalg.eigh(inertia)
    squares = np.maximum(np.sum(moments) / 2 - moments, 0.0)  # m/5 times the squared half-axes
    lengths = np.sqrt(squares / np.max(squares))
    angles = np.linspace(0.0, 2 * math.pi, POINTS + 1)
    lines = []
    for azimuth in np.arange(MERIDIANS) * math.pi / MERIDIANS:
        across = np.sin(angles)
        lines.append([across * math.cos(azimuth), across * math.sin(azimuth), np.cos(angles)])
    for height in np.linspace(-1.0, 1.0, PARALLELS + 2)[1:-1]:
        across = math.sqrt(1 - height**2)
        level = np.full_like(angles, height)
        lines.append([across * np.cos(angles), across * np.sin(angles), level])
    # The poles of the lines lie on the symmetry axis, if there is one.
    pole = 0 if moments[1] - moments[0] > moments[2] - moments[1] else 2
    order = [(pole + 1) % 3, (pole + 2) % 3, pole]
    points = np.einsum("ik,lkp->ilp", axes[:, order] * lengths[order], np.array(lines))
    first, last = points[..., :-1], points[..., 1:]
    return tuple(np.concatenate([first.reshape(3, -1), last.reshape(3, -1)]))


def _set_range(span: Any, low: float, high: float) -> None:
    span.update(start=low, end=high, reset_start=low, reset_end=high)


def _figure(y: str, name: str, **options: Any) -> Any:
    """Return a figure against τ."""
    plot = wide_figure(
        name,
        HEIGHT,
        tools="pan,box_zoom,wheel_zoom,reset",
        x_axis_label="τ = t/τ₀",
        y_axis_label=y,
        x_range=Range1d(start=1.0, end=10.0),
        y_range=Range1d(start=1.0, end=10.0),
        **options,
    )
    plot.toolbar.autohide = True
    return plot
