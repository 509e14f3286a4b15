"""The figures: what they show against known values, and what the command writes and refuses."""

import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
import pytest
from click.testing import CliRunner
from matplotlib.text import Annotation

from dipoletop import Level, Outcome, TransverseReduced, cli, validation
from dipoletop._base.statistics import wilson
from dipoletop.cli import commands
from dipoletop.paper import figure_data, figures


def invoke(*arguments):
    return CliRunner().invoke(cli.main, ["figures", *map(str, arguments)])


def test_starts_are_isotropic():
    starts = figure_data.even_starts(500)
    np.testing.assert_allclose(np.sum(starts**2, axis=1), 0.04, rtol=1e-12)
    unit = np.column_stack([starts, -starts]).reshape(-1, 3) / 0.2
    np.testing.assert_allclose(unit.T @ unit / len(unit), np.eye(3) / 3, atol=2e-3)
    # Of an even half sphere ω₃ is uniform in (0, 1), and the azimuth is too.
    azimuth = np.sort(np.arctan2(starts[:, 1], starts[:, 0])) / (2 * np.pi) + 0.5
    np.testing.assert_allclose(azimuth, (np.arange(500) + 0.5) / 500, atol=0.01)


def test_shares_at_order_1_are_the_known_ones():
    deltas, starts = [-0.7, -0.4, -0.2, 0.0], figure_data.even_starts(256)
    basin = figure_data.outcomes_by_shape(Level.ORDER_1, deltas, starts)
    residual, stop = figure_data.shares(basin)
    assert (residual.label, stop.label) == ("residual rotation", "stop, rotating")
    # By 200 000 random starts; here the error is that of 256, 0.03, at most.
    np.testing.assert_allclose(residual.share, [0, 0.1402, 0.5197, 1], atol=0.02)
    assert residual.share[0] == 0  # stop below δ = −1/2,
    assert residual.share[3] == 1  # none for the sphere
    np.testing.assert_allclose(residual.share + stop.share, 1, rtol=1e-15)
    ends = wilson(np.sum(basin.outcome == Outcome.RESIDUAL, axis=1), 256)
    np.testing.assert_array_equal([residual.low, residual.high], ends)


@pytest.mark.parametrize(
    ("phi", "orbit"),
    [(np.pi / 30, validation.RESIDUAL_ORBIT), (np.pi / 3, validation.STOPPING_ORBIT)],
)
def test_motions_of_figure_2_are_the_known_ones(phi, orbit):
    found = figure_data.motion(Level.ORDER_1, phi, np.array([0.0, 10.0, 100.0, 1000.0]))
    np.testing.assert_allclose(found.omega[1:], np.array(orbit)[:3], atol=1e-9)


def test_eigenvalues_at_order_1_are_those_of_the_paper():
    d = np.linspace(-1, 0.9, 9)
    found = figure_data.eigenvalues(Level.ORDER_1, d, 0.05)
    expected = -np.sort([np.ones(9), (1 + 2 * d) / (1 - d)], axis=0).T  # (4.22)–(4.24)
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-12)


def test_limit_of_eigenvalues_solves_the_characteristic_equation():
    d = np.linspace(-1, 0.9, 9)
    for x in figure_data.small_w(d).T:  # λ = xw² in that of the full equation, leading order
        np.testing.assert_allclose((1 - d) * x**2 + (2 + d) * x + 1, 0, atol=1e-12)


def test_boundary_is_scaled_and_its_jump_is_cut(monkeypatch):
    def boundary(system, phi):
        assert system.corrected
        assert system.delta == -0.2
        return jnp.where(phi < 1, 2 + phi / 10, 5.0)

    monkeypatch.setattr(figure_data.planar, "boundary", boundary)
    found = figure_data.small_boundary(True, np.linspace(0, 2, 5))
    np.testing.assert_allclose(found, 0.04 * np.array([2, 2.05, np.nan, 5, 5]), rtol=1e-12)


def test_maps_compare_every_fifth_start(monkeypatch):
    """The other equations are played by order 1 at another δ, which is compiled already."""

    def order_1(level, delta):
        return TransverseReduced(-0.3 if level is Level.SEMI else delta)

    monkeypatch.setattr(figure_data, "equation_at", order_1)
    found = figure_data.level_maps(16, 5, 0.4)
    assert found.semi.shape == (16, 16)
    assert 0 < np.mean(found.order_1_differs) < 0.4
    np.testing.assert_array_equal(found.full_differs, found.order_1_differs[::5, ::5])
    at = {name: found.semi.coords[name] for name in ("w3", "phi")}
    np.testing.assert_allclose([at["w3"][[0, -1]], at["phi"][[0, -1]]], [[0, 0.4], [0, np.pi]])


def test_domains_and_curves_of_figure_3():
    figure = figures.rotator_plane()
    (ax,) = figure.axes
    curves = {line.get_label().split(",")[0]: line.get_xydata() for line in ax.lines}
    at = np.argmin(np.abs(curves["AOC"][:, 0] - 1))
    assert curves["AOC"][at, 0] == 1
    assert curves["AOC"][at, 1] == pytest.approx(-0.4734467160950165, rel=1e-12)
    assert curves["AOC in closed form"][at, 1] == pytest.approx(-1 / 3**0.5, rel=1e-12)
    # ϖ > f runs away upwards, and ϖ > g has come from below.
    minus, plus = r"{-}\infty", r"{+}\infty"
    letters = {text.get_text(): text.xy for text in ax.texts if isinstance(text, Annotation)}
    texts = {x.get_position(): x.get_text() for x in ax.texts if not isinstance(x, Annotation)}
    for (w, rate), text in texts.items():
        past = minus if rate > 1.5 or w < -1 else plus
        future = plus if rate > 0 else minus
        assert text == rf"$\omega: {past}\to{future}$"
    assert len(texts) == 4
    # The letters of the legend stand on their curves.
    assert sorted(letters) == ["A", "B", "C", "D", "O"]
    assert letters.pop("O") == (0, 0)
    for letter, (w, rate) in letters.items():
        curve = curves["AOC" if letter in "AC" else "BOD"]
        assert rate == curve[np.searchsorted(curve[:, 0], w), 1]
        assert (w < 0) == (letter in "AB")


def test_the_command_writes_what_is_asked_for(tmp_path):
    before = dict(mpl.rcParams)
    result = invoke("3", "--output", tmp_path / "new")
    assert result.exit_code == 0, result.output
    pdf, png = (tmp_path / "new" / f"figure-3.{suffix}" for suffix in ("pdf", "png"))
    assert result.output.splitlines() == [f"Figure: {pdf}", f"Figure: {png}"]
    assert sorted(path.name for path in pdf.parent.iterdir()) == [pdf.name, png.name]
    content = pdf.read_bytes()
    assert b"/Type0" in content  # fonts that are embedded as TrueType,
    assert b"/Type3" not in content
    assert b"CreationDate" not in content
    assert dict(mpl.rcParams) == before
    again = invoke("3", "3", "--format", "pdf", "--output", tmp_path / "again")
    assert again.output == f"Figure: {tmp_path / 'again' / 'figure-3.pdf'}\n"
    assert (tmp_path / "again" / "figure-3.pdf").read_bytes() == content


def test_an_unknown_figure_is_refused_in_one_line(tmp_path):
    result = invoke("4", "--output", tmp_path / "new")
    assert result.exit_code == 2
    (line,) = [line for line in result.stderr.splitlines() if line.startswith("Error: ")]
    assert "'4' is not one of '1', '1-full', '2', '3', 'spectra', 'levels'" in line
    assert not (tmp_path / "new").exists()


def test_the_command_knows_every_figure():
    assert list(figures.FIGURES) == list(commands.FIGURES.choices)
    assert all(name in invoke("--help").output for name in figures.FIGURES)
