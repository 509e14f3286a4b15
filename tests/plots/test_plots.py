"""Pictures say what the data say: unfolding, colours, legends, titles, refusals."""

import itertools
import subprocess
import sys

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.collections import PathCollection, QuadMesh
from matplotlib.colors import to_rgb, to_rgba

import dipoletop as dt
from dipoletop import Outcome, Stop, plots
from dipoletop.plots.plane import CLASSES, SIGNED

R, S, U, F = Outcome.RESIDUAL, Outcome.STOP, Outcome.UNDECIDED, Outcome.FAILED


@pytest.fixture(autouse=True)
def close_figures():
    yield
    plt.close("all")


def whole_problem(phi, delta, w3):
    return dt.TransverseReduced(delta), dt.cylindrical(0.2, w3, phi)


def made(outcome, omega_inf=0.0, stop=Stop.NONE, time=1.0, certified=True, axes=None):
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


def pixels(ax):
    return np.asarray(ax.images[0].get_array())


def legend(ax):
    return [text.get_text() for text in ax.get_legend().get_texts()]


def byte(colour):
    return np.round(255 * np.array(to_rgba(colour))).astype(np.uint8)


# Unfolding


def test_unfolded_cell_equals_a_sweep_of_the_whole_plane():
    phi, w3 = np.arange(8) * np.pi / 8, np.linspace(0.0, 0.4, 5)
    cell = dt.Grid(phi=phi, delta=[-0.2, 0.3], w3=w3)
    round_, axial = np.arange(16) * np.pi / 8, np.linspace(-0.4, 0.4, 9)
    plane = dt.sweep(whole_problem, dt.Grid(phi=round_, delta=[-0.2, 0.3], w3=axial))
    unfolded = plots.unfold(dt.sweep(whole_problem, cell))
    assert unfolded.dims == plane.dims
    assert unfolded.shape == plane.shape == (16, 2, 9)
    for name in plane.coords:
        np.testing.assert_allclose(unfolded.coords[name], plane.coords[name], atol=1e-14)
    for name in ("outcome", "stop", "certified"):
        np.testing.assert_array_equal(unfolded.column(name), plane.column(name))
    # Both outcomes and both signs occur, so that the comparison is worth something.
    assert set(plane.fractions()) == {"RESIDUAL", "STOP"}
    assert np.nanmin(plane.omega_inf) < -0.05 < 0.05 < np.nanmax(plane.omega_inf)
    np.testing.assert_allclose(unfolded.omega_inf, plane.omega_inf, rtol=1e-6, atol=1e-12)
    assert not np.signbit(unfolded.omega_inf[unfolded.outcome == S]).any()
    assert unfolded.level == plane.level


def test_a_circle_is_mirrored_but_not_extended():
    axes = {"w3": np.array([0.1, 0.3]), "phi": np.arange(6) * np.pi / 3}
    half = made(np.array([[R, S, R, U, S, F], [S, S, S, R, R, R]]), axes=axes)
    whole = plots.unfold(half)
    assert whole.shape == (4, 6)
    np.testing.assert_array_equal(whole.coords["w3"], [-0.3, -0.1, 0.1, 0.3])
    np.testing.assert_array_equal(whole.outcome[2:], half.outcome)
    np.testing.assert_array_equal(whole.outcome[1], half.outcome[0, [0, 5, 4, 3, 2, 1]])
    np.testing.assert_array_equal(whole.outcome[0], half.outcome[1, [0, 5, 4, 3, 2, 1]])


@pytest.mark.parametrize(
    "axes",
    [
        {"w3": [0.0, 0.1], "delta": [-0.2, 0.2]},
        {"w3": [0.0, 0.1], "phi": [0.0, 1.0]},
        {"w3": [0.0, 0.1], "phi": np.linspace(0.0, np.pi, 5)},
        {"w3": [-0.1, 0.1], "phi": [0.0, np.pi]},
        {"w3": [0.2, 0.1], "phi": [0.0, np.pi]},
        {"w3": [0.1], "phi": [0.0]},
    ],
)
def test_what_is_no_symmetry_cell_is_left_as_it_is(axes):
    given = made(np.full([len(values) for values in axes.values()], R), axes=axes)
    assert plots.unfold(given) is given


def test_a_map_of_a_cell_shows_the_whole_plane_and_closes_the_circle():
    cell = dt.symmetry_cell(6, 4, 0.3)
    rng = np.random.default_rng(3)
    found = made(rng.choice([R, S], (4, 6)), rng.normal(size=(4, 6)), axes=cell.coords)
    whole = plots.unfold(found)
    ax = plots.basin(found)
    image = pixels(ax)
    assert image.shape == (7, 13, 4)
    np.testing.assert_array_equal(image[:, 12], image[:, 0])
    stops = np.all(image == byte(CLASSES[S, Stop.NONE][1]), axis=-1)
    np.testing.assert_array_equal(stops[:, :12], whole.outcome == S)
    assert (ax.get_xlabel(), ax.get_ylabel()) == (r"$\varphi$", r"$\omega_3$")
    ax.figure.canvas.draw()
    labels = [tick.get_text() for tick in ax.get_xticklabels()]
    for label in ("0", r"$\pi/2$", r"$\pi$", r"$3\pi/2$", r"$2\pi$"):
        assert label in labels
    assert pixels(plots.basin(found, unfold=False)).shape == (4, 6, 4)


# Colours and legends


def test_every_class_has_its_colour_and_its_legend_entry():
    ax = plots.basin(every_class(), shade=None)
    image = pixels(ax)
    for k, (label, colour) in enumerate(CLASSES.values()):
        np.testing.assert_array_equal(image[:, k + 1], np.tile(byte(colour), (3, 1)))
        handle = ax.get_legend().legend_handles[k]
        assert handle.get_facecolor() == to_rgba(colour)
        assert legend(ax)[k] == label
    assert len(legend(ax)) == len(CLASSES)
    assert ax.figure.axes == [ax]  # no colourbar


def test_only_what_occurs_is_in_the_legend():
    found = made([[R, R, S], [R, S, S]], stop=Stop.ROTATING)
    assert legend(plots.basin(found, shade=None)) == ["residual rotation", "stop, rotating"]


def test_a_class_too_rare_to_see_is_counted():
    outcome = np.full((50, 50), R)
    outcome[7, 7] = U
    assert legend(plots.basin(made(outcome), shade=None))[1] == "undecided (1 start)"


def test_residual_rotation_is_shaded_by_its_sign_and_size():
    ax = plots.basin(every_class())
    image = pixels(ax)
    np.testing.assert_array_equal(image[0, 0], SIGNED(0.0, bytes=True))  # ω∞ = −0.2, the largest
    np.testing.assert_allclose(image[0, 1], SIGNED(0.75, bytes=True), atol=2)  # ω∞ = 0.1
    np.testing.assert_array_equal(image[0, 2], byte(CLASSES[S, Stop.ROTATING][1]))
    assert legend(ax)[:2] == [r"residual, $\omega_\infty > 0$", r"residual, $\omega_\infty < 0$"]
    bar = ax.figure.axes[1]
    assert bar.get_ylim() == (-0.2, 0.2)
    assert r"\omega_\infty" in bar.get_ylabel()
    assert "dimensionless" in bar.get_ylabel()


def test_no_residual_rotation_no_colourbar():
    ax = plots.basin(made([[S, S], [S, U]]))
    assert ax.figure.axes == [ax]
    assert legend(ax) == ["stop", "undecided"]


def test_time_shades_both_outcomes_darker_the_later():
    time = np.array([[0.0, 1e1, 1e2, 1e3], [0.0, 1e1, 1e2, 1e3], [1e3] * 4])
    ax = plots.basin(made([[R] * 4, [S] * 4, [U] * 4], time=time), shade="time")
    image = pixels(ax).astype(int)
    light = image[..., :3].sum(-1)
    assert np.all(np.diff(light[:2, 1:]) < -60)
    assert np.all(light[:2, 0] >= light[:2, 1])
    assert np.all(image[0, 1:, 2] > image[0, 1:, 0])  # blue: residual rotation
    assert np.all(image[1, 1:, 2] < image[1, 1:, 0])  # brown: stop
    np.testing.assert_array_equal(image[2, 0], byte(CLASSES[U, Stop.NONE][1]))
    assert legend(ax) == ["residual rotation", "stop", "undecided"]
    assert {a.get_ylabel() for a in ax.figure.axes[1:]} == {
        r"$\tau$ when residual rotation is certain",
        r"$\tau$ when stop is certain",
    }


def test_time_needs_no_positive_time():
    ax = plots.basin(made([[R, R], [R, R]], time=0.0), shade="time")
    assert len(np.unique(pixels(ax).reshape(-1, 4), axis=0)) == 1


# Machado, Oliveira & Fernandes (2009), severity 1: linear RGB as the colour-blind see it.
SIGHT = {
    "normal": np.eye(3),
    "protan": np.array(
        [
            [0.152286, 1.052583, -0.204868],
            [0.114503, 0.786281, 0.099216],
            [-0.003882, -0.048116, 1.051998],
        ]
    ),
    "deutan": np.array(
        [
            [0.367322, 0.860646, -0.227968],
            [0.280085, 0.672501, 0.047413],
            [-0.011820, 0.042940, 0.968881],
        ]
    ),
    "tritan": np.array(
        [
            [1.255528, -0.076749, -0.178779],
            [-0.078411, 0.930809, 0.147602],
            [0.004733, 0.691367, 0.303900],
        ]
    ),
}


def cielab(colour, sight):
    """CIE 1976 L*a*b* of an sRGB colour under D65."""
    rgb = np.array(to_rgb(colour))
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    linear = np.clip(sight @ linear, 0, 1)
    to_xyz = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    xyz = np.array(to_xyz) @ linear / np.array([0.9505, 1.0, 1.089])
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("sight", SIGHT)
def test_colours_differ_to_every_eye(sight):
    # A difference of 2.3 is just noticeable; 15 is plain also in small patches.
    def apart(one, other):
        return np.linalg.norm(cielab(one, SIGHT[sight]) - cielab(other, SIGHT[sight]))

    colours = [colour for _, colour in CLASSES.values()]
    assert min(apart(a, b) for a, b in itertools.combinations(colours, 2)) > 20
    ramp = SIGNED(np.linspace(0, 1, 21))
    assert min(apart(a, b) for a in colours[1:] for b in ramp) > 15


# Axes and titles


@pytest.mark.parametrize(
    ("certified", "words"),
    [
        (True, "all outcomes certified for this level"),
        (False, "no outcome certified for this level"),
        (
            [[True, True, False], [True, True, True]],
            "83.3 % of the outcomes certified for this level",
        ),
    ],
)
def test_the_title_says_the_level_what_is_fixed_and_what_is_certified(certified, words):
    axes = {"amplitude": [0.3, 0.4], "delta": [-0.2], "w1": [0.0, 1.0, 2.0]}
    certified = np.expand_dims(certified, -2) if np.ndim(certified) else certified
    found = made([[[R, R, R]], [[R, S, R]]], certified=certified, axes=axes)
    assert plots.basin(found).get_title() == f"Semi-reduced\n$\\delta$ = −0.2, {words}"


def test_shares_are_never_rounded_to_none_or_all():
    some = np.zeros((100, 100), bool)
    some[0, :3] = True
    assert "< 0.1 %" in plots.basin(made(np.full((100, 100), R), certified=some)).get_title()
    assert "99.9 %" in plots.basin(made(np.full((100, 100), R), certified=~some)).get_title()


def test_orientation_and_extent():
    found = made([[R, S, U], [F, R, R]], axes={"w_perp": [0.1, 0.3], "delta": [-0.2, 0.0, 0.2]})
    labels = np.array([[0, 5, 6], [7, 0, 0]])
    colours = np.array([byte(colour) for _, colour in CLASSES.values()])
    ax = plots.basin(found, shade=None)
    np.testing.assert_array_equal(pixels(ax), colours[labels])
    assert ax.images[0].origin == "lower"
    np.testing.assert_allclose(ax.images[0].get_extent(), [-0.3, 0.3, 0.0, 0.4], atol=1e-15)
    assert (ax.get_xlabel(), ax.get_ylabel()) == (r"$\delta$", r"$\omega_\perp$")
    turned = plots.basin(found, shade=None, x="w_perp")
    np.testing.assert_array_equal(pixels(turned), colours[labels.T])
    assert (turned.get_xlabel(), turned.get_ylabel()) == (r"$\omega_\perp$", r"$\delta$")
    same = plots.basin(found, shade=None, y="delta")
    np.testing.assert_array_equal(pixels(same), colours[labels.T])


def test_phi_is_horizontal_whatever_its_place_and_a_falling_axis_is_turned():
    axes = {"phi": [0.0, 1.0, 2.0], "mass": [2.0, 1.0]}
    ax = plots.basin(made([[R, S], [U, S], [F, R]], axes=axes), shade=None)
    colours = np.array([byte(colour) for _, colour in CLASSES.values()])
    np.testing.assert_array_equal(pixels(ax), colours[np.array([[5, 5, 0], [0, 6, 7]])])
    assert (ax.get_xlabel(), ax.get_ylabel()) == (r"$\varphi$", "mass")


def test_logarithmic_and_uneven_axes():
    axes = {"amplitude": np.geomspace(1e-3, 1.0, 4), "delta": [-0.3, -0.1, 0.3]}
    found = made(np.array([[R, S, S], [R, R, S], [U, R, S], [R, R, F]]), axes=axes)
    ax = plots.basin(found, shade=None)
    (mesh,) = (c for c in ax.collections if isinstance(c, QuadMesh))
    assert (ax.get_xscale(), ax.get_yscale()) == ("linear", "log")
    corners = mesh.get_coordinates()
    np.testing.assert_allclose(corners[0, :, 0], [-0.4, -0.2, 0.1, 0.5])
    np.testing.assert_allclose(corners[:, 0, 1], np.geomspace(10**-3.5, 10**0.5, 5))
    np.testing.assert_array_equal(mesh.get_array()[2, 0], byte(CLASSES[U, Stop.NONE][1]))
    assert mesh.get_rasterized()


def test_drawing_on_given_axes_makes_no_other_figure():
    figure, axes = plt.subplots(1, 3)
    assert plots.basin(every_class(), ax=axes[0]) is axes[0]
    assert plots.compare(every_class(), every_class(), axes=axes[1:]) is figure
    assert plt.get_fignums() == [figure.number]
    assert axes[0].images[0].get_rasterized()


def sample_basin():
    columns = {"outcome": np.ones(5, np.int8)}
    return dt.Basin(("sample",), (5,), {}, columns, {"level": "semi-reduced"})


@pytest.mark.parametrize(
    ("found", "options", "message"),
    [
        (sample_basin(), {}, "`basin` must be over a grid, but is over a sample"),
        (
            made(np.full((3, 1), R)),
            {},
            r"`basin` must have exactly two axes .* has w_perp \(3\), delta \(1\)",
        ),
        (
            made(np.full((2, 2), R), axes={"way": np.eye(3)[:2], "delta": [0.1, 0.2]}),
            {},
            "`basin` must have exactly two axes of numbers",
        ),
        (made([[R, S], [R, S]]), {"x": "w3"}, "`x` must be 'w_perp' or 'delta', but is 'w3'"),
        (made([[R, S], [R, S]]), {"x": "delta", "y": "delta"}, "`y` must be the other axis"),
        (made([[R, S], [R, S]]), {"shade": "steps"}, "`shade` must be 'omega_inf', 'time'"),
    ],
)
def test_refusals(found, options, message):
    with pytest.raises(ValueError, match=message):
        plots.basin(found, **options)
    assert plt.get_fignums() == []


def test_three_long_axes_are_refused_by_name():
    grid = dt.Grid(delta=[0.1, 0.2], w3=[0.0, 0.1, 0.2], phi=[0.0, 1.0])
    columns = {"outcome": np.ones(12, np.int8)}
    found = dt.Basin(grid.dims, grid.shape, grid.coords, columns, {"level": "x"})
    with pytest.raises(ValueError, match=r"has delta \(2\), w3 \(3\), phi \(2\); sweep a grid"):
        plots.basin(found)


# Comparison


def test_compare_hatches_exactly_the_starts_that_differ():
    first = np.full((9, 12), R)
    second = first.copy()
    second[2:5, 3:7] = S
    second[7, 9] = U
    one, two = made(first, 0.1), made(second, np.where(second == R, -0.3, 0.0))
    figure = plots.compare(one, two)
    left, right, bar = figure.axes
    assert bar.get_ylim() == (-0.3, 0.3)  # one scale for both
    np.testing.assert_allclose(pixels(left)[0, 0], SIGNED(0.5 + 0.1 / 0.6, bytes=True), atol=2)
    np.testing.assert_array_equal(pixels(right)[0, 0], SIGNED(0.0, bytes=True))
    ys, xs = np.meshgrid(*one.coords.values(), indexing="ij")
    for ax in (left, right):
        assert "differs for 12 % of the starts" in ax.get_title()
        assert legend(ax)[-1] == "outcome differs"
        marks = [c for c in ax.collections if isinstance(c, PathCollection)]
        assert {c.get_hatch() for c in marks} == {"///"}
        colours = {tuple(c.get_edgecolor()[0]) for c in marks}
        assert colours == {to_rgba("white"), to_rgba("black")}
        for mark in marks:
            points = np.stack([xs.ravel(), ys.ravel()], 1)
            inside = np.any([p.contains_points(points) for p in mark.get_paths()], axis=0)
            np.testing.assert_array_equal(inside, (first != second).ravel())
    assert legend(right)[-2] == "undecided"
    assert "undecided" not in legend(left)


@pytest.mark.parametrize(("other", "share"), [(R, "0 %"), (S, "100 %")])
def test_compare_when_nothing_or_everything_differs(other, share):
    figure = plots.compare(made(np.full((4, 4), R), 0.1), made(np.full((4, 4), other)))
    assert all(f"differs for {share} of the starts" in ax.get_title() for ax in figure.axes[:2])
    marked = any(isinstance(c, PathCollection) for c in figure.axes[0].collections)
    assert marked == (other == S)
    figure.canvas.draw()


def test_compare_counts_the_starts_of_the_cell_once():
    cell = dt.symmetry_cell(4, 2)
    first, second = np.full((2, 4), R), np.full((2, 4), R)
    second[0, 1] = S  # at ω₃ = 0, which unfolding does not double
    figure = plots.compare(made(first, 0.1, axes=cell.coords), made(second, axes=cell.coords))
    assert "differs for 12.5 % of the starts" in figure.axes[0].get_title()


@pytest.mark.parametrize(
    ("axes", "message"),
    [
        ({"w_perp": [0.1, 0.2], "phi": [0.0, 0.1]}, r"is over w_perp \(2\), phi \(2\)"),
        ({"w_perp": [0.1, 0.2], "delta": [0.0, 0.1]}, "has other values of delta"),
    ],
)
def test_compare_refuses_another_grid(axes, message):
    one = made(np.full((2, 2), R), axes={"w_perp": [0.1, 0.2], "delta": [0.0, 0.2]})
    with pytest.raises(ValueError, match=message):
        plots.compare(one, made(np.full((2, 2), R), axes=axes))


# Trajectories


def curves(ax):
    return {line.get_label(): line for line in ax.lines}


def test_a_trajectory_that_keeps_a_residual_rotation():
    ts = np.concatenate([[0.0], np.geomspace(0.5, 3e3, 60)])
    run = dt.simulate(dt.TransverseReduced(-0.2), dt.cylindrical(0.2, 0.2, np.pi / 30), ts)
    ax = plots.trajectory(run)
    drawn = curves(ax)
    omega = np.asarray(run.omega)
    for k in range(3):
        np.testing.assert_array_equal(drawn[rf"$\omega_{k + 1}$"].get_ydata(), omega[:, k])
    np.testing.assert_allclose(drawn[r"$|\omega|$"].get_ydata(), np.linalg.norm(omega, axis=1))
    np.testing.assert_array_equal(drawn[r"$|\omega|$"].get_xdata(), ts)
    assert r"$\omega_\infty = 0.09887$" in drawn  # Fig. 2a of the paper
    assert r"$\propto\tau^{-1/2}$" not in drawn
    assert (ax.get_xscale(), ax.get_xlim()) == ("symlog", (0.0, 3e3))
    assert ax.get_title() == "Reduced, order 1 (the paper's)"


def test_a_trajectory_that_stops_has_its_power_law():
    ts = np.geomspace(1.0, 1e4, 40)
    run = dt.simulate(dt.TransverseReduced(-0.2), dt.cylindrical(0.2, 0.2, np.pi / 3), ts)
    _, given = plt.subplots()
    ax = plots.trajectory(run, ax=given)
    assert ax is given
    law = curves(ax)[r"$\propto\tau^{-1/2}$"]
    slope = np.diff(np.log(law.get_ydata())) / np.diff(np.log(law.get_xdata()))
    np.testing.assert_allclose(slope, -0.5)
    np.testing.assert_allclose(law.get_ydata()[-1], np.linalg.norm(run.omega[-1]))
    assert ax.get_xscale() == "log"


def test_a_level_without_a_verdict_has_no_asymptote():
    ts = np.array([0.0, 1.0, 2.0])
    run = dt.simulate(dt.TransverseAveraged(-0.2), dt.cylindrical(0.2, 0.2, 1.0), ts)
    ax = plots.trajectory(run)
    assert legend(ax) == [r"$|\omega|$", r"$\omega_1$", r"$\omega_2$", r"$\omega_3$"]


def test_a_batch_of_trajectories_is_refused():
    times, states = jnp.zeros((4, 3)), jnp.zeros((4, 3, 3))
    batch = dt.Trajectory(dt.TransverseReduced(0.1), times, states, None, None)
    with pytest.raises(ValueError, match="must be that of one top, but has times of shape"):
        plots.trajectory(batch)


def test_matplotlib_waits_for_a_picture():
    script = "import sys, dipoletop; assert 'matplotlib' not in sys.modules; dipoletop.plots.basin"
    subprocess.run([sys.executable, "-c", script], check=True)
