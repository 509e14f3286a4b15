"""Pictures of atlases: cells, hatching, legend, particles, refusals. Nothing is computed here."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgba

from dipoletop import Fate, plots
from dipoletop.atlases import BODY_CORNERS, Atlas, cells
from dipoletop.plots.atlases import MOST, RATIOS, STOPS


def made(dipole_axis, ends, ratio=0.3):
    """An atlas of four cells, each with its probabilities of some fates."""
    corners = cells(2)
    moments = np.column_stack([np.mean(corners, axis=1) @ BODY_CORNERS, np.ones(4)])
    dipole = np.sqrt(np.mean(corners, axis=1))
    if dipole_axis:
        dipole = np.tile(np.eye(3)[dipole_axis - 1], (4, 1))
    probability = np.zeros((4, 8))
    for cell, share in zip(probability, ends, strict=True):
        for place, value in share.items():
            cell[place] = value
    ratios = np.where(np.sum(probability[:, :2], axis=1) > 0, ratio, 0.0)
    return Atlas(dipole_axis, 2, corners, moments, dipole, probability, ratios, np.zeros(4))


RESIDUAL = {Fate.POSITIVE: 0.5, Fate.NEGATIVE: 0.5}
BOTH = {Fate.POSITIVE: 0.3, Fate.TUMBLING_LOW: 0.7}
SPIN, TUMBLING = {Fate.AXIS_3: 1.0}, {Fate.TUMBLING_LOW: 1.0}


def collections(ax):
    return [each for each in ax.collections if isinstance(each, PolyCollection)]


def test_cells_have_the_colours_of_their_ends():
    figure = plots.atlas(
        [made(1, [RESIDUAL, BOTH, RESIDUAL, RESIDUAL]), made(2, [SPIN, TUMBLING] * 2)]
    )
    first, second, bar = figure.axes
    cells_of_first, hatched = collections(first)
    np.testing.assert_allclose(cells_of_first.get_facecolors(), np.tile(RATIOS(0.3 / MOST), (4, 1)))
    assert len(hatched.get_paths()) == 1
    (plain,) = collections(second)
    colours = [to_rgba(STOPS[ending][1]) for ending in list(STOPS)[:2]] * 2
    np.testing.assert_allclose(plain.get_facecolors(), colours)
    assert bar.get_ylabel() == r"mean $L_\infty/L_0$, residual rotation"
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert texts == [
        "residual, from every start",
        "residual or a stop, by the start",
        "stop, spinning about $J_3$",
        "stop, tumbling about $J_3$",
    ]
    assert first.get_title(loc="left").endswith("residual 75 %, by the start 25 %")
    assert second.get_title(loc="left").endswith("never residual")
    # The cells are those of the triangle of bodies.
    vertices = np.concatenate([path.vertices for path in plain.get_paths()])
    assert np.all((vertices[:, 0] <= vertices[:, 1]) & (vertices[:, 1] >= 1 - vertices[:, 0]))


def test_particles_stand_at_their_moments():
    (ax,) = plt.figure().subplots(1, 1, squeeze=False)[0]
    plots.atlas(made(3, [RESIDUAL] * 4), axes=ax)
    marks = [line.get_xydata()[0].tolist() for line in ax.lines if line.get_marker() == "o"]
    # DAST, 100 × 100 × 50 nm: (100² + 50²)/(2·100²); cellulose, 300 × 30 × 30 nm.
    fibre = 2 * 30**2 / (300**2 + 30**2)
    assert sorted(marks) == [[round(fibre, 4), 1.0], [0.625, 0.625], [1.0, 1.0]]
    bare = plots.atlas(made(3, [RESIDUAL] * 4), particles=False).axes[0]
    assert not bare.lines


def test_a_map_over_dipoles_has_its_corners_named():
    figure = plots.atlas(made(None, [SPIN, {2: 1.0}, {6: 1.0}, {2: 0.4, 4: 0.6}]))
    (ax,) = figure.axes
    assert {text.get_text() for text in ax.texts} == {f"dipole on $J_{k}$" for k in (1, 2, 3)}
    filled, hatched = collections(ax)
    assert len(hatched.get_paths()) == 1
    np.testing.assert_allclose(filled.get_facecolors()[3], to_rgba("#202020"))
    # The first cell has the greatest n₃², so it is at the lower right, as is the name of J₃.
    places = {text.get_text(): text.xy for text in ax.texts}
    middle = np.mean(filled.get_paths()[0].vertices[:3], axis=0)
    assert np.hypot(*(middle - places["dipole on $J_3$"])) < 0.4


def test_bad_arguments_are_refused():
    with pytest.raises(
        ValueError, match="`atlases` must be an Atlas or a sequence of them, but is"
    ):
        plots.atlas([])
    with pytest.raises(ValueError, match="`axes` must be 2, one for each atlas, but has 1"):
        plots.atlas([made(3, [RESIDUAL] * 4)] * 2, axes=plt.subplots()[1])
