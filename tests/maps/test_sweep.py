"""Sweeps: grids and samples, agreement with `classify`, fractions, storage, refusals."""

import shutil

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import ode

import dipoletop as dt
from dipoletop import Outcome
from dipoletop._maps.tiles import Tiles


def reduced(w3, phi, delta=-0.2):
    return dt.TransverseReduced(delta), dt.cylindrical(0.2, w3, phi)


GRID = dt.Grid(w3=np.linspace(0.0, 0.45, 10), phi=np.linspace(0.0, 3.0, 26))


@pytest.fixture(scope="module")
def basin():
    return dt.sweep(reduced, GRID)


@pytest.mark.parametrize("level", [dt.TransverseReduced, dt.TransverseSemi])
def test_labels_equal_classify_point_by_point(level):
    def problem(w3, phi):
        return level(-0.2), dt.cylindrical(0.2, w3, phi)

    found = dt.sweep(problem, GRID)
    assert found.shape == (10, 26)
    w3, phi = np.meshgrid(*GRID.axes.values(), indexing="ij")
    one = jax.lax.map(lambda at: dt.classify(*problem(*at)), (w3.ravel(), phi.ravel()))
    for name in ("outcome", "certified", "stop"):
        assert np.array_equal(found.column(name).ravel(), getattr(one, name))
    assert np.max(np.abs(found.omega_inf.ravel() - one.omega_inf)) < 1e-8


def _first_order(_, w, d):
    """(4.2)–(4.4) typed again."""
    w1, w2, w3 = w.tolist()
    s = w1**2 + w2**2 + w3**2
    return [
        d * w2 * w3,
        -d * w1 * w3 - (s + d * (1 + d) * w3**2) * w2,
        -(s + d * (2 * w1**2 - w2**2)) * w3 / (1 - d),
    ]


def _semi_reduced(_, w, d):
    """ω₂′ + 2ω₁ω₃′ = r₂ and (1−δ)ω₃′ − 2ω₁ω₂′ = r₃, with ω₂′ eliminated."""
    w1, w2, w3 = w.tolist()
    s = w1**2 + w2**2 + w3**2
    r2 = -d * w1 * w3 - s * w2 - d * (1 + d) * w2 * w3**2
    r3 = -s * w3 + d * w2**2 * w3
    p3 = (r3 + 2 * w1 * r2) / (1 - d + 4 * w1**2)
    return [d * w2 * w3, r2 - 2 * w1 * p3, p3]


@pytest.mark.parametrize(
    ("level", "rate"), [(dt.TransverseReduced, _first_order), (dt.TransverseSemi, _semi_reduced)]
)
def test_labels_equal_an_independent_integrator_on_500_points(level, rate):
    """scipy's DOP853 at 1e-12, run until rotation or the residual line has plainly won."""

    def shape(w3, phi, delta):
        return level(delta), dt.cylindrical(0.2, w3, phi)

    def draw(key):
        a, b, c = jax.random.split(key, 3)
        return {
            "w3": jax.random.uniform(a, (), float, 0.02, 0.5),
            "phi": jax.random.uniform(b, (), float, 0, jnp.pi),
            "delta": jax.random.uniform(c, (), float, -0.45, -0.15),
        }

    sample = dt.Sample(n=500, seed=4, draw=draw)
    found = dt.sweep(shape, sample, value=False)
    points = jax.tree.map(np.asarray, sample.points(np.arange(500)))
    for i in range(500):
        w3, phi, d = (float(points[name][i]) for name in ("w3", "phi", "delta"))
        start = [0.2 * np.cos(phi), 0.2 * np.sin(phi), w3]
        assert found.outcome[i] == _destiny(rate, d, start), (d, start)


def _destiny(rate, d, start):
    """No certificate: the line is all but reached, or precession is far ahead of braking."""
    seen = []

    def look(_, w):
        if abs(d * w[2]) > 6 * (w[0] ** 2 + w[1] ** 2):
            seen.append(Outcome.STOP)
        elif (w[0] * w[1]) ** 2 + (d * w[2]) ** 2 < 1e-4 * w[0] ** 4:
            seen.append(Outcome.RESIDUAL)
        return -1 if seen else 0  # -1 ends the run

    # The compiled DOP853; that of `solve_ivp` is Python, and many times slower.
    run = ode(lambda t, w: rate(t, w, d)).set_integrator(
        "dop853", rtol=1e-12, atol=1e-16, nsteps=100_000
    )
    run.set_solout(look)
    run.set_initial_value(start)
    run.integrate(1e12)
    assert seen, "no decision by τ = 1e12"
    return seen[0]


@pytest.mark.parametrize(
    ("level", "amplitude", "delta", "expected", "error"),
    [
        # 200 000 starts each, with their standard errors
        (dt.TransverseReduced, 0.2, -0.4, 0.1402, 0.0008),
        (dt.TransverseReduced, 0.2, -0.2, 0.5197, 0.0011),
        (dt.TransverseReduced, 0.2, -0.1, 0.7755, 0.0009),
        (dt.TransverseReduced, 0.2, -0.05, 0.8972, 0.0007),
        # 20 000 starts each
        (dt.TransverseSemi, 0.2, -0.9, 0.0675, 0.0018),
        (dt.TransverseSemi, 0.2, -0.5, 0.2096, 0.0029),
        (dt.TransverseSemi, 0.2, -0.3, 0.4154, 0.0035),
        (dt.TransverseSemi, 0.2, -0.1, 0.7973, 0.0028),
        (dt.TransverseSemi, 1.0, -0.9, 0.3556, 0.0034),
        (dt.TransverseSemi, 1.0, -0.2, 0.8937, 0.0022),
        (dt.TransverseSemi, 0.01, -0.9, 0.0036, 0.0005),
        (dt.TransverseSemi, 0.2, -0.2, 0.5894, 0.0035),
        (dt.TransverseSemi, 1.0, -0.5, 0.6541, 0.0034),
        (dt.TransverseSemi, 0.01, -0.2, 0.0437, 0.0014),
    ],
)
def test_residual_fractions(level, amplitude, delta, expected, error):
    """Isotropic starts, N = 20 000: within four standard errors of both samples."""
    n = 20_000
    sample = dt.Sample(n=n, amplitude=amplitude, seed=1)
    found = dt.sweep(lambda w: (level(delta), w), sample, value=False)
    share = found.fractions()["RESIDUAL"].share
    both = np.hypot(error, np.sqrt(expected * (1 - expected) / n))
    assert abs(share - expected) < 4 * both
    assert found.fractions().keys() <= {"RESIDUAL", "STOP"}


@pytest.mark.parametrize(
    ("delta", "expected"), [(-0.9, 0.0675), (-0.5, 0.2096), (-0.3, 0.1139), (-0.2, 0.0629)]
)
def test_share_of_starts_that_end_differently_at_the_two_levels(delta, expected):
    sample = dt.Sample(n=20_000, amplitude=0.2, seed=1)
    first, semi = (
        dt.sweep(lambda w, level=level: (level(delta), w), sample, value=False)
        for level in (dt.TransverseReduced, dt.TransverseSemi)
    )
    assert abs(np.mean(first.outcome != semi.outcome) - expected) < 0.01


def test_sample_depends_on_seed_and_number_only():
    long, short = dt.Sample(n=100, seed=3), dt.Sample(n=10, seed=3)
    assert np.array_equal(long.points(np.arange(10)), short.points(np.arange(10)))
    assert np.array_equal(long.points(np.array([7])), short.points(np.arange(10))[7:8])
    assert not np.array_equal(
        long.points(np.arange(10)), dt.Sample(n=10, seed=4).points(np.arange(10))
    )


def test_isotropic_starts_are_isotropic():
    w = np.asarray(dt.Sample(n=20_000, amplitude=0.2, seed=0).points(np.arange(20_000)))
    assert np.allclose(np.linalg.norm(w, axis=1), 0.2, rtol=1e-14)
    assert np.all(np.abs(w.mean(0)) < 4 * 0.2 / np.sqrt(3 * 20_000))
    assert np.allclose(np.cov(w.T) / 0.04 * 3, np.eye(3), atol=0.05)
    sizes = np.linalg.norm(dt.Sample(n=5000, amplitude=(1e-3, 1.0)).points(np.arange(5000)), axis=1)
    assert abs(np.log(sizes).mean() - np.log(1e-3) / 2) < 0.15
    box = np.asarray(
        dt.Sample(n=500, draw=dt.uniform_box([0, 1, 2], [1, 2, 4])).points(np.arange(500))
    )
    assert np.all((box >= [0, 1, 2]) & (box <= [1, 2, 4]))


def test_axes_of_any_kind():
    """Shapes, amplitudes and directions as axes; a single number is an axis of length 1."""
    ways = np.array([[1.0, 0.2, 0.1], [0.1, 0.2, 1.0]])

    def problem(delta, size, way):
        return dt.TransverseSemi(delta), size * way

    grid = dt.Grid(delta=-0.3, size=[0.1, 0.3], way=ways)
    found = dt.sweep(problem, grid)
    assert found.shape == (1, 2, 2)
    for i, size in enumerate([0.1, 0.3]):
        for j, way in enumerate(ways):
            one = dt.classify(dt.TransverseSemi(-0.3), size * way)
            assert int(found.outcome[0, i, j]) == int(one.outcome)


def test_bad_points_are_failed_lanes():
    found = dt.sweep(reduced, dt.Grid(delta=[-0.2, 1.0, -3.0], w3=0.2, phi=[0.1, 1.0]))
    assert np.all(found.outcome[1:] == Outcome.FAILED)
    assert np.all(np.isnan(found.omega_inf[1:]))
    assert found.outcome[0, 0, 0] == Outcome.RESIDUAL


def test_symmetry_cell():
    grid = dt.symmetry_cell(n_phi=8, n_w3=5, w3_max=0.4)
    assert grid.shape == (5, 8)
    assert grid.axes["phi"][-1] == np.pi * 7 / 8
    assert grid.axes["w3"][-1] == 0.4


def test_confirmation_at_a_second_tolerance():
    found = dt.sweep(reduced, GRID, rtol=1e-4, confirm=1e-9)
    exact = dt.sweep(reduced, GRID, rtol=1e-9)
    assert np.array_equal(found.changed, found.outcome != exact.outcome)
    # Nearer to the boundary than the tolerance, a start can carry either label.
    low, high = 0.1, 1.0
    for _ in range(3):
        line = dt.sweep(reduced, dt.Grid(w3=0.2, phi=np.linspace(low, high, 128)), rtol=1e-11)
        last = int(np.flatnonzero(np.diff(line.outcome[0]))[0])
        low, high = line.coords["phi"][last : last + 2]
    near = dt.Grid(w3=0.2, phi=np.linspace(low, high, 128))
    assert dt.sweep(reduced, near, rtol=1e-3, confirm=1e-11).changed.any()
    assert not dt.sweep(reduced, near, rtol=1e-11, confirm=1e-12).changed.any()


def test_xarray_names_units_and_sources(basin):
    data = basin.to_xarray()
    assert data.omega_inf.dims == ("w3", "phi")
    assert data.omega_inf.attrs["units"] == data.w3.attrs["units"] == "1/tau_0"
    assert data.phi.attrs["units"] == "rad"
    assert np.array_equal(data.phi, GRID.axes["phi"])
    assert data.attrs["level"] == "reduced, order 1 (the paper's)"
    assert data.attrs["rtol"] == 1e-8
    assert data.attrs["version_dipoletop"] == dt.__version__


def same(a, b):
    return all(np.array_equal(a.column(n), b.column(n), equal_nan=True) for n in a.columns)


def test_save_and_load(basin, tmp_path):
    basin.save(tmp_path / "map.zarr")
    back = dt.Basin.load(tmp_path / "map.zarr")
    assert same(basin, back)
    assert back.attrs == basin.attrs
    assert np.array_equal(back.coords["w3"], basin.coords["w3"])
    with pytest.raises(ValueError, match="`path` must not exist yet"):
        basin.save(tmp_path / "map.zarr")


def files(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_a_sweep_goes_on_where_it_stopped(tmp_path, monkeypatch):
    """Killed half-way, with a torn tile: the same bytes as a run in one go."""
    monkeypatch.setattr("dipoletop._maps.sweep.TILE", 128)
    grid = dt.Grid(w3=np.linspace(0.0, 0.45, 20), phi=np.linspace(0.0, 3.0, 50))
    whole = dt.sweep(reduced, grid, store=tmp_path / "whole.zarr")
    place = tmp_path / "again.zarr"
    shutil.copytree(tmp_path / "whole.zarr", place)
    for tile in (0, 3, 7):
        (place / "done" / "c" / str(tile) / "0").unlink()
    (place / "omega_inf" / "c" / "3").unlink()
    (place / "outcome" / "c" / "7").write_bytes(b"torn")
    with pytest.raises(ValueError, match="lacks 3 of 8 tiles; run the sweep again with this store"):
        dt.Basin.load(place)

    made = []
    write = Tiles.write
    monkeypatch.setattr(Tiles, "write", lambda *a: (made.append(a[1]), write(*a)))
    again = dt.sweep(reduced, grid, store=place)
    assert sorted(made) == [0, 3, 7]
    assert same(whole, again)
    assert files(place) == files(tmp_path / "whole.zarr")
    assert same(whole, dt.sweep(reduced, grid, store=place))
    assert sorted(made) == [0, 3, 7]


def test_a_foreign_store_is_refused_and_untouched(tmp_path):
    place = tmp_path / "map.zarr"
    grid = dt.Grid(w3=[0.1, 0.2], phi=[0.1, 1.0])
    dt.sweep(reduced, grid, store=place)
    before = files(place)
    others = [
        (lambda w3, phi: (dt.TransverseSemi(-0.2), dt.cylindrical(0.2, w3, phi)), grid, {}),
        (lambda w3, phi: (dt.TransverseReduced(-0.3), dt.cylindrical(0.2, w3, phi)), grid, {}),
        (reduced, dt.Grid(w3=[0.1, 0.3], phi=[0.1, 1.0]), {}),
        (reduced, dt.Grid(w3=[0.1, 0.2, 0.3], phi=[0.1]), {}),
        (reduced, grid, {"rtol": 1e-9}),
    ]
    for problem, over, options in others:
        with pytest.raises(ValueError, match="`store` must be new or hold this very sweep"):
            dt.sweep(problem, over, store=place, **options)
    assert files(place) == before


def test_what_is_no_basin_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"`path` must be a folder with a basin, but .* not exist"):
        dt.Basin.load(tmp_path / "none.zarr")
    (tmp_path / "text").write_text("hello")
    with pytest.raises(ValueError, match="`path` must be a folder with a basin"):
        dt.Basin.load(tmp_path / "text")
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match="`path` must be a folder with a basin"):
        dt.Basin.load(tmp_path / "empty")


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: dt.Grid(), "`axes` must name at least one axis"),
        (lambda: dt.Grid(w3=[]), "`w3` must hold at least one value"),
        (lambda: dt.Grid(w3=[0.1, np.nan]), "`w3` must be finite"),
        (lambda: dt.Grid(w3=["a"]), "`w3` must be a real array"),
        (lambda: dt.Sample(n=0), "`n` must be a positive whole number, but is 0"),
        (lambda: dt.Sample(n=5, seed=0.5), "`seed` must be a whole number, but is 0.5"),
        (lambda: dt.Sample(n=5, amplitude=-1.0), "`amplitude` must be positive, or a pair"),
        (lambda: dt.Sample(n=5, amplitude=(1.0, 0.1)), "`amplitude` must be positive, or a pair"),
        (
            lambda: dt.sweep(reduced, dt.Grid(w3=[0.1], theta=[0.2])),
            r"`over` must name the arguments of `problem` .* but has w3, theta",
        ),
        (lambda: dt.sweep(lambda w: w, dt.Sample(n=5)), "`problem` must return .equation, omega0."),
        (
            lambda: dt.sweep(lambda w: (dt.TransverseReduced(0.1), w[:2]), dt.Sample(n=5)),
            r"`omega0 of problem` must have shape \(3,\), but has shape \(2,\)",
        ),
        (
            lambda: dt.sweep(lambda w: (dt.TransverseAveraged(0.1), w), dt.Sample(n=5)),
            "`equation` must have a method",
        ),
        (lambda: dt.sweep(reduced, GRID, confirm=1e-20), "`confirm` must lie between"),
    ],
)
def test_bad_input_is_refused_in_one_sentence(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_memory_and_work_do_not_grow_with_padding():
    """The last tile is filled up with starts that take no step."""
    found = dt.sweep(reduced, dt.Grid(w3=[0.2], phi=[np.pi / 3]))
    assert found.shape == (1, 1)
    assert found.steps[0, 0] > 0
