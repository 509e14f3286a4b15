"""The pieces of which a page consists: texts, columns, figures, and the sources of their data."""

from typing import Any

import panel as pn
from bokeh.models import ColumnDataSource
from bokeh.plotting import figure

from .texts import CSS

WIDE: Any = {"sizing_mode": "stretch_width"}


def box(*panes: Any, flex: str, width: int = 290) -> Any:
    """Return a column that shares a row with others."""
    return pn.Column(*panes, min_width=width, styles={"flex": flex})


def html(text: str = "", margin: tuple[int, ...] = (3, 10)) -> Any:
    """Return a pane for a text of `texts`."""
    return pn.pane.HTML(text, stylesheets=[CSS], margin=margin, **WIDE)


def source(name: str, *columns: str) -> Any:
    """Return a source of data, empty at first."""
    return ColumnDataSource({column: [] for column in columns}, name=name)


def wide_figure(name: str, height: int, **options: Any) -> Any:
    """Return a figure as wide as its column."""
    plot = figure(name=name, height=height, **WIDE, **options)
    plot.toolbar.logo = None
    return plot


def pane_of(plot: Any) -> Any:
    """Return the pane of a figure as wide as its column."""
    return pn.pane.Bokeh(plot, min_width=280, height=plot.height, **WIDE)
