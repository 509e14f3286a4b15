"""Basins made by hand, and what is read from their pictures."""

import numpy as np
from matplotlib.colors import to_rgba

import dipoletop as dt
from dipoletop import Outcome, Stop
from dipoletop.plots.map_layout import CLASSES

R, S, U, F = Outcome.RESIDUAL, Outcome.STOP, Outcome.UNDECIDED, Outcome.FAILED


def made(outcome, omega_inf=0.0, stop=Stop.NONE, time=1.0, certified=True, axes=None, **others):
    """A basin with these columns, rows along w_perp and columns along delta."""
    outcome = np.asarray(outcome, np.int8)
    if axes is None:
        n, m = outcome.shape
        axes = {"w_perp": np.linspace(0.1, 0.4, n), "delta": np.linspace(-0.4, 0.2, m)}
    given = {
        "outcome": outcome,
        "omega_inf": np.asarray(omega_inf, float),
        "time": np.asarray(time, float),
        "steps": np.int32(7),
        "certified": np.asarray(certified),
        "stop": np.asarray(stop, np.int8),
    }
    given |= {name: np.asarray(values) for name, values in others.items()}
    columns = {name: np.broadcast_to(v, outcome.shape).ravel() for name, v in given.items()}
    grid = dt.Grid(**axes)
    return dt.Basin(grid.dims, grid.shape, grid.coords, columns, {"level": "semi-reduced"})


def every_class():
    """One column of starts for each class; the extra first column is a second residual one."""
    outcomes, stops = zip(*CLASSES, strict=True)
    outcome = np.tile([R, *outcomes], (3, 1))
    value = np.where(outcome == R, 0.1, np.where(outcome == S, 0.0, np.nan))
    value[:, 0] = -0.2
    return made(outcome, value, np.tile([Stop.NONE, *stops], (3, 1)))


def sample(outcome, omega_inf):
    """A basin over single starts, four at most."""
    starts = np.array([[0.1, 0.0, 0.0], [0.0, 0.2, 0.0], [0.0, -0.1, 0.1], [0.0, 0.0, -0.3]])
    n = len(outcome)
    columns = {
        "outcome": np.array(outcome, np.int8),
        "omega_inf": np.array(omega_inf),
        "stop": np.zeros(n, np.int8),
        "certified": np.array([True, False, True, True])[:n],
        "omega0": starts[:n],
        "gamma": np.arange(n) / 10,
    }
    return dt.Basin(("sample",), (n,), {}, columns, {"level": "semi-reduced"})


def pixels(ax):
    return np.asarray(ax.images[0].get_array())


def legend(ax):
    return [text.get_text() for text in (ax.get_legend() or ax.figure.legends[0]).get_texts()]


def byte(colour):
    return np.round(255 * np.array(to_rgba(colour))).astype(np.uint8)
