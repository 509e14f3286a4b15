"""The animation of a spinning body: where body, dipole and ω point in every frame."""

import numpy as np
import pytest
from matplotlib.animation import AbstractMovieWriter, PillowWriter

import dipoletop as dt
from dipoletop import plots
from dipoletop.plots.animations import _ellipsoid

LEVEL = [1.0, 0.0, 0.0, 0.0]


@pytest.fixture(scope="module")
def run():
    ts = np.linspace(0, 30, 31)
    start = dt.cylindrical(0.2, 0.2, 0.4)
    return dt.simulate(dt.TransverseSemi(-0.2), start, ts, attitude=LEVEL)


class Recorder(AbstractMovieWriter):
    """Keeps the title of every frame, and the end of each trace."""

    def __init__(self):
        super().__init__()
        self.frames = []

    def setup(self, fig, outfile, dpi=None):
        super().setup(fig, outfile, dpi)

    def grab_frame(self, **_):
        (ax,) = self.fig.axes
        tips = [np.array(line.get_data_3d())[:, -1] for line in ax.lines]
        self.frames.append((ax.get_title(), tips))

    def finish(self):
        pass


def test_frames_show_the_dipole_and_omega_in_the_laboratory(run):
    recorder = Recorder()
    plots.animate(run, frames=4).save("unused", writer=recorder)
    drawn = recorder.frames
    assert [title.split(",")[0] for title, _ in drawn] == [
        rf"Semi-reduced: $\tau$ = {k}" for k in (0, 10, 20, 30)
    ]
    spin = np.asarray(run.to_laboratory(run.omega))
    for k, (_, (dipole, omega)) in zip((0, 10, 20, 30), drawn, strict=True):
        np.testing.assert_allclose(dipole, 1.25 * run.dipole[k], atol=1e-12)
        expected = 1.25 * spin[k] / np.linalg.norm(spin, axis=1).max()
        np.testing.assert_allclose(omega, expected, atol=1e-12)


def test_an_animation_is_written(run, tmp_path):
    plots.animate(run, frames=2).save(tmp_path / "spin.gif", writer=PillowWriter(fps=5))
    assert (tmp_path / "spin.gif").read_bytes()[:4] == b"GIF8"


@pytest.mark.parametrize("semi_axes", [(1.0, 1.0, 1.0), (2.0, 2.0, 1.0), (3.0, 2.0, 1.0)])
def test_the_ellipsoid_has_the_moments_of_the_body(semi_axes):
    a, b, c = semi_axes
    inertia = np.diag([b**2 + c**2, c**2 + a**2, a**2 + b**2]) / 5
    surface = _ellipsoid(dt.Body(inertia, [1.0, 0.0, 0.0]))
    np.testing.assert_allclose(np.abs(surface).max(axis=(1, 2)), np.array(semi_axes) / a, rtol=0.03)


def test_refusals(run):
    plain = dt.simulate(dt.TransverseSemi(-0.2), [0.1, 0.1, 0.1], [0.0, 1.0])
    with pytest.raises(ValueError, match="`attitude` must be given to `simulate`"):
        plots.animate(plain)
    with pytest.raises(ValueError, match="`frames` must be"):
        plots.animate(run, frames=0)
