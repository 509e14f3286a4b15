"""Maps say what the data say: colours, legends, axes, comparison, refusals."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
from made_basins import F, R, S, U, byte, every_class, legend, made, pixels, sample
from matplotlib.collections import PathCollection, QuadMesh
from matplotlib.colors import to_rgba

import dipoletop as dt
from dipoletop import Stop, plots
from dipoletop.plots.column_shading import SIGNED, UNKNOWN
from dipoletop.plots.map_layout import CHANCE, CLASSES

COLOURS = np.array([byte(colour) for _, colour in CLASSES.values()])


def test_both_senses_of_rotation_are_lettered():
    """In a grey copy, too; nothing is written where there is one sense only, or no wide region."""
    outcome, values = np.full((20, 30), R), np.full((20, 30), 0.1)
    values[:, 18:] = -0.1
    outcome[:, 14:18] = S
    ax = plots.basin(made(outcome, values))
    found = {text.get_text(): text.get_position() for text in ax.texts}
    xs = np.linspace(-0.4, 0.2, 30)
    assert set(found) == {"+", "−"}
    assert found["+"][0] < xs[14]
    assert found["−"][0] > xs[17]
    assert not plots.basin(made(outcome, np.abs(values))).texts
    assert all(text.get_clip_on() and not text.get_in_layout() for text in ax.texts)


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


# Keywords of matplotlib


def test_keywords_reach_the_image_and_a_colour_map_the_shading():
    ax = plots.basin(every_class(), alpha=0.4, zorder=3, cmap="PuOr")
    (image,) = ax.images
    assert (image.get_alpha(), image.get_zorder()) == (0.4, 3)
    colours = {mappable.cmap.name for mappable in _colourbars(ax)}
    assert colours == {"PuOr"}
    uneven = made(np.full((2, 3), S), axes={"a": [0.0, 1.0], "b": [0.0, 1.0, 5.0]})
    (mesh,) = [x for x in plots.basin(uneven, alpha=0.4).collections if isinstance(x, QuadMesh)]
    assert mesh.get_alpha() == 0.4
    figure = plots.compare(every_class(), every_class(), alpha=0.3)
    assert [ax.images[0].get_alpha() for ax in figure.axes[:2]] == [0.3, 0.3]
    with pytest.raises(ValueError, match=r"`cmap` must be the name of a colour map .*'no'"):
        plots.basin(every_class(), cmap="no")


def _colourbars(ax):
    return [bar.mappable for x in ax.figure.axes if (bar := getattr(x, "_colorbar", None))]


def test_steps_shade_both_outcomes_beside_whole_numbers():
    found = made([[R, S, S], [R, S, U]], steps=np.int32([[6, 13, 50], [10, 25, 60]]))
    ax = plots.basin(found, shade="steps")
    light = pixels(ax)[..., :3].astype(int).sum(-1)
    assert light[0, 1] > light[0, 2]
    assert light[0, 0] > light[1, 0]
    bars = ax.figure.axes[1:]
    labels = {f"steps of runs that end with {end}" for end in ("residual rotation", "stop")}
    assert {bar.get_ylabel() for bar in bars} == labels
    ax.figure.canvas.draw()
    for axis in (bar.yaxis for bar in bars):
        ticks = [*axis.get_ticklabels(), *axis.get_ticklabels(minor=True)]
        texts = {tick.get_text() for tick in ticks if tick.get_text()}
        assert "20" in texts
        assert all(text.isdecimal() for text in texts)


# Colours and legends


def test_every_class_has_its_colour_and_its_legend_entry():
    ax = plots.basin(every_class(), shade=None)
    image = pixels(ax)
    for k, (label, colour) in enumerate(CLASSES.values()):
        np.testing.assert_array_equal(image[:, k + 1], np.tile(byte(colour), (3, 1)))
        handle = ax.figure.legends[0].legend_handles[k]
        assert handle.get_facecolor() == to_rgba(colour)
        assert legend(ax)[k] == label
    assert len(legend(ax)) == len(CLASSES)
    assert ax.figure.axes == [ax]  # no colourbar


def test_only_what_occurs_is_in_the_legend_and_what_is_too_rare_to_see_is_counted():
    found = made([[R, R, S], [R, S, S]], stop=Stop.ROTATING)
    assert legend(plots.basin(found, shade=None)) == ["residual rotation", "stop, rotating"]
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


def test_what_is_not_known_has_a_colour_of_its_own():
    """ω∞ whose sense is a matter of chance leaves the colours of the others as they are."""
    ax = plots.basin(made([[R, R, S], [R, R, S]], np.array([[1e-40, np.nan, 0.0], [-5e-41, 0, 0]])))
    name, colour = r"residual, $\omega_\infty$ not known", UNKNOWN
    image = pixels(ax)
    np.testing.assert_array_equal(image[0, 1], byte(colour))
    np.testing.assert_array_equal(image[0, 0], SIGNED(1.0, bytes=True))
    np.testing.assert_allclose(image[1, 0], SIGNED(0.25, bytes=True), atol=2)
    assert legend(ax)[2:] == [name, "stop"]
    late = plots.basin(made([[R, R], [R, R]], time=np.array([[1.0, np.nan], [5, 9]])), shade="time")
    np.testing.assert_array_equal(pixels(late)[0, 1], byte(CLASSES[R, Stop.NONE][1]))
    assert legend(late) == ["residual rotation"]


@pytest.mark.parametrize(("least", "name"), [(0.2, CHANCE), (np.nan, "undecided")])
def test_undecided_starts_are_a_matter_of_chance_if_all_are(least, name):
    found = made([[R, U], [U, S]], probability=[[1.0, least], [0.7, 0.0]])
    assert legend(plots.basin(found, shade=None)) == ["residual rotation", "stop", name]


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
    assert np.all(image[1, 1:, 2] < image[1, 1:, 0])  # olive: stop
    np.testing.assert_array_equal(image[2, 0], byte(CLASSES[U, Stop.NONE][1]))
    assert legend(ax) == ["residual rotation", "stop", "undecided"]
    bars = ax.figure.axes[1:]
    labels = {rf"$\tau$ when {end} is certain" for end in ("residual rotation", "stop")}
    assert {bar.get_ylabel() for bar in bars} == labels
    ax.figure.canvas.draw()
    for bar in bars:
        assert any(label.get_visible() and label.get_text() for label in bar.get_yticklabels())
        assert bar.yaxis.get_tick_params()["labelright"]


def test_derivatives_shade_residual_rotation_by_their_sign():
    slopes = np.array([[-3.0, 0.002, 0.0], [3.0, np.inf, 0.0]])
    found = made([[R, R, S]] * 2, [[0.1, 0.1, 0.0]] * 2, d_omega_inf_d_delta=slopes)
    ax = plots.basin(found, shade="d_omega_inf_d_delta")
    image = pixels(ax)
    np.testing.assert_allclose(image[0, 0], SIGNED(0.0, bytes=True), atol=3)
    np.testing.assert_allclose(image[1, 0], SIGNED(1.0, bytes=True), atol=3)
    np.testing.assert_array_equal(image[1, 1], byte(UNKNOWN))
    np.testing.assert_array_equal(image[0, 2], byte(CLASSES[S, Stop.NONE][1]))
    assert ax.figure.axes[1].get_ylabel() == r"$\partial\omega_\infty/\partial \delta$"
    assert legend(ax)[2:] == ["residual, no derivative", "stop"]


def test_errors_shade_residual_rotation():
    errors = np.array([[1e-12, 1e-6, 0.0], [1e-9, np.inf, 0.0]])
    found = made([[R, R, S]] * 2, [[0.1, 0.1, 0.0]] * 2, omega_inf_error=errors)
    ax = plots.basin(found, shade="omega_inf_error")
    light = pixels(ax)[..., :3].astype(int).sum(-1)
    assert light[0, 0] > light[1, 0] > light[0, 1]
    np.testing.assert_array_equal(pixels(ax)[1, 1], byte(UNKNOWN))


def test_what_is_not_certified_is_hatched():
    certified = np.ones((9, 12), bool)
    certified[2:5, 3:7] = False
    found = made(np.full((9, 12), R), certified=certified)
    ax = plots.basin(found, shade="certified")
    assert legend(ax) == ["residual rotation", "not certified"]
    assert_hatched(ax, found, ~certified)


def assert_hatched(ax, found, expected):
    """White and black lines hatch exactly the expected starts."""
    marks = [c for c in ax.collections if isinstance(c, PathCollection)]
    assert {c.get_hatch() for c in marks} == {"///"}
    colours = {tuple(c.get_edgecolor()[0]) for c in marks}
    assert colours == {to_rgba("white"), to_rgba("black")}
    ys, xs = np.meshgrid(*found.coords.values(), indexing="ij")
    points = np.stack([xs.ravel(), ys.ravel()], 1)
    for mark in marks:
        inside = np.any([p.contains_points(points) for p in mark.get_paths()], axis=0)
        np.testing.assert_array_equal(inside, expected.ravel())


def test_chance_is_shaded_by_probability():
    found = made([[R, U], [U, S]], probability=[[1.0, 0.2], [0.7, 0.0]])
    ax = plots.basin(found, shade="probability")
    light = pixels(ax)[..., :3].astype(int).sum(-1)
    assert light[0, 1] > light[1, 0]
    assert ax.figure.axes[1].get_ylim() == (0, 1)


def three_axes():
    rng = np.random.default_rng(5)
    outcome = rng.choice([R, S], (3, 4, 5))
    axes = {"delta": [-0.3, -0.2, 0.1], "w3": [0.0, 0.1, 0.2, 0.3], "w1": np.arange(5.0)}
    value = np.where(outcome == R, rng.normal(size=outcome.shape), 0.0)
    return made(outcome, value, axes=axes)


def test_other_axes_are_fixed_at_the_nearest_value():
    found = three_axes()
    ax = plots.basin(found, at={"delta": -0.21}, x="w3")
    np.testing.assert_array_equal(pixels(ax), pixels(plots.basin(found.isel(delta=1), x="w3")))
    assert r"$\delta$ = −0.2" in ax.get_title()


def test_panels_share_their_colours_and_say_their_values():
    found = three_axes()
    axes = plots.basin(found, panels="delta", shade="omega_inf")
    assert [ax.get_title().split("\n")[1].split(",")[0] for ax in axes] == [
        rf"$\delta$ = {x}" for x in ("−0.3", "−0.2", "0.1")
    ]
    most = np.nanmax(np.abs(found.omega_inf))
    (bar,) = set(axes[0].figure.axes) - set(axes)
    assert bar.get_ylim() == (-most, most)
    for k, ax in enumerate(axes):
        one = found.isel(delta=k)
        stops = np.all(pixels(ax) == byte(CLASSES[S, Stop.NONE][1]), axis=-1)
        np.testing.assert_array_equal(stops, one.outcome == S)


def test_titles_give_multiples_of_pi_as_such():
    axes = {"phi": [np.pi / 30], "theta": [-2 * np.pi / 3], "w1": [0.1, 0.2], "w2": [0.3, 0.4]}
    title = plots.basin(made(np.full((1, 1, 2, 2), R), axes=axes)).get_title()
    assert r"$\varphi$ = π/30, $\vartheta$ = −2π/3, " in title


def test_time_needs_no_positive_time():
    ax = plots.basin(made([[R, R], [R, R]], time=0.0), shade="time")
    assert len(np.unique(pixels(ax).reshape(-1, 4), axis=0)) == 1


# Axes


def test_orientation_and_extent():
    found = made([[R, S, U], [F, R, R]], axes={"w_perp": [0.1, 0.3], "delta": [-0.2, 0.0, 0.2]})
    labels = np.array([[0, 5, 6], [7, 0, 0]])
    ax = plots.basin(found, shade=None)
    np.testing.assert_array_equal(pixels(ax), COLOURS[labels])
    assert ax.images[0].origin == "lower"
    np.testing.assert_allclose(ax.images[0].get_extent(), [-0.3, 0.3, 0.0, 0.4], atol=1e-15)
    assert (ax.get_xlabel(), ax.get_ylabel()) == (r"$\delta$", r"$\omega_\perp$")
    turned = plots.basin(found, shade=None, x="w_perp")
    np.testing.assert_array_equal(pixels(turned), COLOURS[labels.T])
    assert (turned.get_xlabel(), turned.get_ylabel()) == (r"$\omega_\perp$", r"$\delta$")
    same = plots.basin(found, shade=None, y="delta")
    np.testing.assert_array_equal(pixels(same), COLOURS[labels.T])


def test_phi_is_horizontal_whatever_its_place_and_a_falling_axis_is_turned():
    axes = {"phi": [0.0, 1.0, 2.0], "mass": [2.0, 1.0]}
    ax = plots.basin(made([[R, S], [U, S], [F, R]], axes=axes), shade=None)
    np.testing.assert_array_equal(pixels(ax), COLOURS[np.array([[5, 5, 0], [0, 6, 7]])])
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
    assert not figure.legends
    assert all(ax.get_legend() is not None for ax in axes)  # a legend of its own


@pytest.mark.parametrize(
    ("found", "options", "message"),
    [
        (sample([R], [0.1]), {}, "`basin` must be over a grid .*, but is over single starts"),
        (
            made(np.full((3, 1), R)),
            {},
            r"`basin` must have exactly two axes .* has w_perp \(3\), delta \(1\)",
        ),
        (
            three_axes(),
            {},
            r"`plots.line` draws a single axis\), but has delta \(3\), w3 \(4\), w1 \(5\)",
        ),
        (
            made(np.full((2, 2), R), axes={"way": np.eye(3)[:2], "delta": [0.1, 0.2]}),
            {},
            "`basin` must have exactly two axes of numbers",
        ),
        (made([[R, S], [R, S]]), {"x": "w3"}, "`x` must be 'w_perp' or 'delta', but is 'w3'"),
        (made([[R, S], [R, S]]), {"x": "delta", "y": "delta"}, "`y` must be the other axis"),
        (made([[R, S], [R, S]]), {"shade": "speed"}, "`shade` must be a column of this basin"),
        (made([[R, S], [R, S]]), {"shade": "probability"}, "`shade` must be a column of this"),
        (made([[R, S], [R, S]]), {"panels": "w3"}, r"`panels` must be an axis of this basin \(w_p"),
        (made([[R, S], [R, S]]), {"at": {"w3": 1.0}}, "must be an axis of this basin"),
    ],
)
def test_refusals(found, options, message):
    with pytest.raises(ValueError, match=message):
        plots.basin(found, **options)
    assert plt.get_fignums() == []


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
    for ax in (left, right):
        assert "differs for 12 % of the starts" in ax.get_title()
        assert_hatched(ax, one, first != second)
    assert legend(left)[-2:] == ["undecided", "outcome differs"]  # one legend for both


def test_a_class_that_is_rare_in_one_of_two_maps_is_named_once():
    rare = np.full((40, 40), S)
    rare[0, 0] = U
    figure = plots.compare(made(rare), made(np.full((40, 40), U)), shade=None)
    assert legend(figure.axes[0]) == ["stop", "undecided", "outcome differs"]


@pytest.mark.parametrize(("other", "share"), [(R, "0 %"), (S, "100 %")])
def test_compare_when_nothing_or_everything_differs(other, share):
    figure = plots.compare(made(np.full((4, 4), R), 0.1), made(np.full((4, 4), other)))
    assert all(f"differs for {share} of the starts" in ax.get_title() for ax in figure.axes[:2])
    marked = any(isinstance(c, PathCollection) for c in figure.axes[0].collections)
    assert marked == (other == S)
    figure.canvas.draw()


def test_compare_takes_axes_and_another_shade():
    one, two = made([[R, S, S], [R, R, S]]), made([[R, S, R], [R, R, S]])
    figure = plots.compare(one, two, x="w_perp", shade="time")
    left, right = figure.axes[:2]
    assert (left.get_xlabel(), left.get_ylabel()) == (r"$\omega_\perp$", r"$\delta$")
    assert right.get_ylabel() == ""
    assert pixels(left).shape == (3, 2, 4)


def test_compare_counts_the_starts_of_a_symmetry_cell_once_and_may_leave_it_as_it_is():
    cell = dt.symmetry_cell(4, 2)
    first, second = np.full((2, 4), R), np.full((2, 4), R)
    second[0, 1] = S  # at ω₃ = 0, which unfolding does not double
    one, two = made(first, 0.1, axes=cell.coords), made(second, axes=cell.coords)
    ax = plots.compare(one, two).axes[0]
    assert "differs for 12.5 % of the starts" in ax.get_title()
    assert pixels(ax).shape == (3, 9, 4)
    assert pixels(plots.compare(one, two, unfold=False).axes[0]).shape == (2, 4, 4)


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
