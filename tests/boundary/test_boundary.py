"""The basin boundary against the limit of small amplitudes, exact level sets and brute force."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import dipoletop as dt
from dipoletop import boundary
from dipoletop._maps.basin import Basin
from dipoletop._maps.columns import COLUMNS
from dipoletop.boundary.crossings import first_change
from dipoletop.planar import Planar, saddle

DELTA = -0.2
Z_S = 4.2553355749  # physics: z_s(0) of order 1
SLOPE = 32.685861  # dz_s/dδ there, the derivative of the manifold of the planar system
RESIDUAL, ROTATING = 1, 5  # fates: ω∞ > 0, and a stop by rotation


def slow(delta, z, phi, w):
    """A start of small amplitude, where the boundary is that of the planar system."""
    return dt.TransverseReduced(delta), dt.cylindrical(w, z * w**2, phi)


def across(z=(4.0, 4.5), **changes):
    """Segments across the boundary at φ = 0."""
    point = {"delta": DELTA, "phi": 0.0, "w": 1e-3, **changes}
    return boundary.bisect(slow, {"z": z[0], **point}, {"z": z[1], **point})


def test_fates_tell_sense_of_rotation_and_kind_of_stop():
    outcome = np.array([-1, 0, 1, 1, 1, 2, 2, 2])
    value = np.array([np.nan, np.nan, 0.1, -0.1, np.nan, 0.0, 0.0, 0.0])
    stop = np.array([0, 0, 0, 0, 0, 1, 2, 4])
    seen = {"outcome": outcome, "omega_inf": value, "stop": stop}
    columns = {name: np.zeros(8, spec.dtype) for name, spec in COLUMNS.items()}
    basin = Basin(("point",), (8,), {}, columns | seen, {})
    np.testing.assert_array_equal(boundary.fate(basin), [-1, 0, 1, 2, 0, 4, 5, 7])


def test_the_change_lies_between_the_last_decided_points():
    fates = np.array(
        [
            [1, 1, 5, 5, 5],
            [1, 0, 0, -1, 5],
            [1, 1, 0, 2, 5],
            [5, 1, 0, 1, 5],
            [1, 1, 0, 1, 1],
            [0, 1, 5, 5, 5],
        ]
    )
    places, there = first_change(fates)
    np.testing.assert_array_equal(there, [True, True, True, True, False, False])
    np.testing.assert_array_equal(places[:4], [[1, 2], [0, 4], [1, 3], [0, 1]])


def test_bisection_ends_at_rounding_and_at_the_universal_boundary():
    w = np.array([1e-3, 1e-2, 1e-2])
    found = across((4.0, np.array([4.5, 4.5, 4.1])), w=w)
    np.testing.assert_array_equal(found.found, [True, True, False])
    assert np.isnan(found.before["z"][2])
    assert list(found.fates[2]) == [RESIDUAL, RESIDUAL]
    np.testing.assert_array_equal(found.fates[:2], [[RESIDUAL, ROTATING]] * 2)
    assert np.all(found.width[:2] <= 2.0**-52)
    assert np.all(found.after["z"][:2] - found.before["z"][:2] <= 2 * np.spacing(4.2))
    np.testing.assert_allclose(found.after["z"][:2] / Z_S - 1, [1.06e-5, 1.06e-3], rtol=0.01)


def test_what_is_undecided_is_left_between():
    rough = boundary.bisect(
        lambda z: slow(DELTA, z, 0.0, 1e-3), {"z": 4.0}, {"z": 4.5}, max_steps=60
    )
    assert 1e-6 < rough.width[0] < 0.1
    exact = across().after["z"][0]
    assert rough.before["z"][0] < exact < rough.after["z"][0]


def test_derivative_is_that_of_bisected_points_and_of_the_planar_limit():
    h = 1e-4
    delta = DELTA + np.array([0.0, 0.0, -h, h, -3 * h, 3 * h])
    found = across(delta=delta, w=np.array([1e-3, 1e-2] + 4 * [1e-3]))

    def derivatives(distance=None):
        return boundary.derivative(found, "z", ["delta", "phi"], distance=distance)

    slope, turning = derivatives().T
    _, _, *near = found.before["z"]
    simple, wide = (near[1] - near[0]) / (2 * h), (near[3] - near[2]) / (6 * h)
    np.testing.assert_allclose(slope[0], simple + (simple - wide) / 8, rtol=1e-8)
    excess = slope[:2] / SLOPE - 1
    assert excess[0] < 3e-5
    np.testing.assert_allclose(excess[1] / excess[0], 100, rtol=0.05)  # O(ω⊥²)
    (far, _), (less, _) = derivatives(1e-3)[0], derivatives(1e-4)[0]
    ratio = (far / slope[0] - 1) / (less / slope[0] - 1)
    np.testing.assert_allclose(ratio, 10, rtol=0.01)  # an error like the distance
    flow = backwards(0.0, [0.0, Z_S])
    np.testing.assert_allclose(turning[0], flow[1] / flow[0], rtol=1e-4)


def backwards(sigma, y):
    """The planar system of order 1, with σ reversed."""
    phi, z = y
    growth = z * (1 - (2 + DELTA) / (1 - DELTA) * np.cos(phi) ** 2)
    return [DELTA * z + np.sin(2 * phi) / 2, -growth]


def test_a_fold_is_passed():
    box = {"phi": (-2.0, 2.0), "z": (0.0, 8.0)}
    curve = boundary.trace(across((2.5, 3.5), phi=-1.5), box, step=0.06, n=14, by="delta")
    phi, z = curve.points.T
    fold = np.argmin(phi)
    assert 3 < fold < len(phi) - 1
    assert np.all(np.diff(z[fold:]) < 0)
    # the same curve as the stable manifold of the saddle, followed from there
    at = saddle(Planar(DELTA, corrected=False))
    start = np.array([at.phi, at.z]) - 1e-7 * np.array([1.0, float(at.stable_slope)])
    manifold = solve_ivp(backwards, (0, 30), start, rtol=1e-10, atol=1e-12, max_step=0.01).y.T
    for point, normal in zip(curve.points, curve.normals, strict=True):
        away = manifold - point
        nearest = away[np.argmin(np.sum(away**2, axis=1))]
        assert abs(normal @ nearest) < 1e-4


def test_an_ellipse_is_an_ellipse():
    # the boundary z = z_s is a level set of the function that is put for z
    def problem(x, y, c):
        return slow(DELTA, c + x**2 + 4.0 * y**2, 0.0, 1e-3)

    level = across().after["z"][0] - 4.0
    start = boundary.bisect(problem, {"x": 0.1, "y": 0.0, "c": 4.0}, {"x": 0.9, "y": 0.2, "c": 4.0})
    box = {"y": (-1.0, 1.0), "x": (-1.0, 1.0)}
    curve = boundary.trace(start, box, step=-0.12, n=100, by="c")
    y, x = curve.points.T
    assert curve.end == "closed"
    np.testing.assert_array_equal(curve.points[0], curve.points[-1])
    np.testing.assert_allclose(x**2 + 4 * y**2, level, rtol=1e-8)
    slope = np.stack([8 * y, 2 * x], axis=1)
    size = np.linalg.norm(slope, axis=1, keepdims=True)
    np.testing.assert_allclose(curve.normals, slope / size, atol=1e-7)
    assert curve.shift is not None
    np.testing.assert_allclose(curve.shift, -slope / size**2, atol=1e-7)
    area = abs(np.sum(x[:-1] * np.diff(y) - y[:-1] * np.diff(x))) / 2
    np.testing.assert_allclose(area, np.pi * level / 2, rtol=0.1)


def test_the_edge_state_is_the_saddle():
    a, b = dt.cylindrical(0.1, 0.0, 0.0), dt.cylindrical(0.1, 0.1, 0.0)
    edge = boundary.edge_state(dt.TransverseReduced(DELTA), a, b, tol=1e-3)
    assert edge.settled
    at = saddle(Planar(DELTA, corrected=False))
    u = np.sum(edge.omega[:, :2] ** 2, axis=1)
    error = np.abs(edge.shape - np.array([float(at.phi), float(at.z)]))
    assert np.all(error[-1] < np.minimum(20 * u[-1], 1e-3))
    assert np.all(edge.width < 1e-8)


def test_no_smaller_kick_changes_the_fate():
    equation, start = dt.TransverseReduced(DELTA), np.array([0.15, 0.1, 0.12])
    least = boundary.minimal_kick(equation, start, directions=60, radii=12)
    assert tuple(least.fates) == (ROTATING, RESIDUAL)
    assert least.defect < 1e-6
    rng = np.random.default_rng(5)
    d = rng.normal(size=(500, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    size = least.size * np.where(np.arange(500) < 400, 0.999, rng.uniform(size=500))
    kicks = np.concatenate([d * size[:, None], [0.999 * least.kick, least.kick]])
    w1, w2, w3 = (start + kicks).T

    def problem(w1, w2, w3):
        return equation, jnp.stack([w1, w2, w3])

    points = dt.Points(w1=w1, w2=w2, w3=w3)
    basin = dt.sweep(problem, points, rtol=1e-10, value="unchecked")
    np.testing.assert_array_equal(boundary.fate(basin), [ROTATING] * 501 + [RESIDUAL])


def test_a_kick_along_one_component_is_a_bisection():
    equation, start = dt.TransverseReduced(DELTA), np.array([0.15, 0.1, 0.12])
    kick = boundary.minimal_kick(equation, start, along=[3], radii=12)
    found = boundary.bisect(
        lambda w3: (equation, jnp.stack([0.15, 0.1, w3])), {"w3": 0.12}, {"w3": 0.06}
    )
    np.testing.assert_allclose(kick.kick, [0.0, 0.0, found.after["w3"][0] - 0.12], rtol=1e-9)
    assert kick.defect == 0


def test_the_residual_share_moves_as_its_differences_say():
    def problem(delta, w3, phi):
        return dt.TransverseReduced(delta), dt.cylindrical(0.2, w3, phi)

    def share(delta, by=(), higher=0.0):
        both = {"delta": delta, "w3": np.linspace(0.02, 0.35, 4) + higher}
        ends = (both | {"phi": 0.03}, both | {"phi": 0.03 + np.pi})
        return boundary.residual_share(problem, *ends, by=by, parts=32)

    found, step = share(DELTA, ("delta", "w3")), 2e-4
    shifts, weights = np.array([-3, -2, -1, 1, 2, 3]), np.array([-1, 9, -45, 45, -9, 1]) / 60
    by_delta = [share(DELTA + step * k).share for k in shifts]
    by_w3 = [share(DELTA, higher=step * k).share for k in shifts]
    exact = np.array([weights @ by_delta, weights @ by_w3]) / step
    np.testing.assert_allclose([*found.slopes.values()], exact, rtol=1e-7)
    # The whole plane by counting, in which a residual share is that of area.
    grid = dt.Grid(w3=np.linspace(0.02, 0.35, 4), phi=0.03 + np.pi * (np.arange(512) + 0.5) / 512)
    counted = dt.sweep(lambda w3, phi: problem(DELTA, w3, phi), grid, progress=False)
    assert found.share == pytest.approx(counted.fractions()["RESIDUAL"].share, abs=2e-3)
    assert found.undecided == 0


def test_a_share_is_not_known_of_segments_where_nothing_is():
    point = {"delta": DELTA, "phi": 0.0, "w": 1e-3}
    ends = {"z": [4.0, 4.0], **point, "delta": [DELTA, 2.0]}, {"z": 4.5, **point}
    found = boundary.residual_share(slow, *ends, by="delta", parts=8)
    assert 0 < found.undecided < 1  # δ = 2 and others between that are too large
    assert np.isfinite([found.share, found.slopes["delta"]]).all()
    ends[1]["delta"] = [DELTA, 3.0]
    found = boundary.residual_share(slow, *ends, by="delta", parts=8)
    assert found.undecided == 0.5
    assert np.isnan([found.share, found.slopes["delta"]]).all()


def test_what_is_not_known_beside_a_boundary_does_not_hide_it():
    """A hole next to the boundary, and one at the beginning, change nothing."""
    known = {"phi": 0.0}, {"phi": 0.464}

    def problem(phi):
        return dt.TransverseReduced(DELTA), dt.cylindrical(0.2, 0.2, phi)

    whole = boundary.residual_share(problem, *known, by="phi", parts=10)
    edge = whole.share * known[1]["phi"]

    def holed(phi):
        hole = (phi < 0.01) | ((phi > edge - 0.02) & (phi < edge - 0.01))
        equation, omega0 = problem(phi)
        return equation, omega0 * jnp.where(hole, jnp.nan, 1.0)

    for ends in (known, known[::-1]):
        exact = boundary.residual_share(problem, *ends, by="phi", parts=10)
        found = boundary.residual_share(holed, *ends, by="phi", parts=10)
        assert found.undecided == pytest.approx(2 / 11)
        assert found.share == pytest.approx(exact.share, abs=1e-13)
        assert found.slopes["phi"] == pytest.approx(exact.slopes["phi"], rel=1e-6)


def test_bad_input_is_one_sentence():
    found = across()
    point = {"z": 4.0, "phi": 0.0, "delta": DELTA, "w": 1e-3}
    start, equation = np.array([0.2, 0.0, 0.1]), dt.TransverseReduced(DELTA)
    box = {"phi": (-1.0, 1.0), "z": (0.0, 8.0)}
    several = dt.TransverseReduced(jnp.array([DELTA, 0.1]))
    for call, words in [
        (lambda: boundary.bisect(slow, point, point | {"z": 4.1}), "`b` must end otherwise"),
        (lambda: boundary.bisect(slow, {}, {}), "`a` must map"),
        (lambda: boundary.bisect(slow, point, {"z": 4.5}), "`b` must name"),
        (lambda: boundary.bisect(slow, point, point | {"z": [4.0, np.nan]}), "`z` must be finite"),
        (lambda: boundary.bisect(slow, point, point | {"delta": 2.0}), r"`delta` must lie in"),
        (lambda: boundary.normal(found, []), "`names` must hold at least one name"),
        (lambda: boundary.normal(found, ["x"]), "`names` must be among"),
        (lambda: boundary.normal(found, ["z"], distance=np.nan), "`distance` must be finite"),
        (lambda: boundary.derivative(found, "z", "z"), "`by` must name coordinates other than"),
        (lambda: boundary.residual_share(slow, point, point, by="x"), "`by` must name"),
        (lambda: boundary.residual_share(slow, point, point, parts=0), "`parts` must be"),
        (lambda: boundary.trace(found, {"phi": (0.0, 1.0)}), "`bounds` must name two"),
        (lambda: boundary.trace(found, box | {"z": (1.0, 1.0)}), "`bounds` must be pairs"),
        (lambda: boundary.trace(found, box, step=0.0), "`step` must not be 0"),
        (lambda: boundary.trace(found, box, by="z"), "`by` must name"),
        (lambda: boundary.minimal_kick(equation, start, along=[4]), "`along` must hold"),
        (lambda: boundary.bisect(slow, point, point, value=False), "`settings` must be among"),
        (lambda: boundary.edge_state(equation, start, start, tol=-1.0), "`tol` must lie between"),
        (lambda: boundary.minimal_kick(several, start), "`equation` must be a single one"),
        (lambda: boundary.minimal_kick(equation, start, largest=-1.0), "`largest` must be"),
    ]:
        with pytest.raises(ValueError, match=words):
            call()
