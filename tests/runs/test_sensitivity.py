"""Derivatives of ω∞ against complex steps, and where there are none."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from settling import Settling

import dipoletop as dt
from benchmarks.accuracy.differences import SHIFTS, WEIGHTS
from dipoletop._base.types import Verdict
from dipoletop._runs.sensitivity import decay_time
from dipoletop.equations._verdicts.transverse import STEEP_FROM
from dipoletop.equations.tangent import Tangent

AXES = ("delta", "w3", "phi")


def first_order(delta, w_perp, w3, phi):
    return dt.TransverseReduced(delta), dt.cylindrical(w_perp, w3, phi)


def cartesian(delta, w1, w2, w3):
    return dt.TransverseReduced(delta), jnp.stack([w1, w2, w3])


def complex_step(delta, w_perp, w3, phi, along):
    """∂ω∞ by a complex step in NumPy, each case in a time of its own, ds = ω²dτ."""
    values = {"delta": delta, "w3": w3, "phi": phi}
    values[along] = values[along] + 1e-30j
    d, angle = values["delta"], values["phi"]
    start = [w_perp * np.cos(angle), w_perp * np.sin(angle), values["w3"] + 0 * angle]

    def rate(s, y):
        w1, w2, w3 = y.reshape(3, -1)
        square = w1**2 + w2**2 + w3**2
        return np.concatenate(
            [
                d * w2 * w3 / square,
                (-d * w1 * w3 - (square + d * (1 + d) * w3**2) * w2) / square,
                -(square + d * (2 * w1**2 - w2**2)) * w3 / (1 - d) / square,
            ]
        )

    y0 = np.concatenate(start).astype(complex)
    found = solve_ivp(rate, (0, 150), y0, method="DOP853", rtol=3e-14, atol=1e-60, t_eval=[150])
    return found.y[: len(delta), -1].imag / 1e-30


@pytest.fixture(scope="module")
def cases():
    """Fifty residual starts at random, and the fifty nearest to the boundary."""
    rng = np.random.default_rng(5)
    n = 2000
    delta, w_perp = rng.uniform(-0.35, 0.5, n), rng.uniform(0.3, 0.8, n)
    points = {
        "delta": delta,
        "w_perp": w_perp,
        "w3": rng.uniform(-0.6, 0.6, n),
        "phi": rng.uniform(0, np.pi, n),
    }
    size = np.abs(dt.sweep(first_order, dt.Points(**points), rtol=1e-10).omega_inf) / w_perp
    residual = np.flatnonzero(size > 0)
    chosen = np.append(residual[np.argsort(size[residual])[:50]], residual[:50])
    return {name: values[chosen] for name, values in points.items()}


@pytest.mark.parametrize("along", AXES)
def test_slopes_are_those_of_a_complex_step(cases, along):
    basin = dt.sweep(first_order, dt.Points(**cases), rtol=1e-12, derivatives=AXES)
    exact = complex_step(**cases, along=along)
    found = basin.derivative(along)
    # Near the boundary ω∞ itself hangs on the start a hundred times more.
    assert np.max(np.abs(found - exact) / np.maximum(np.abs(exact), 1e-2)) < 1e-8
    assert np.min(np.abs(basin.omega_inf)) < 0.05 * np.max(np.abs(basin.omega_inf))


def test_the_default_tolerance_holds_for_slopes(cases):
    precise = dt.sweep(first_order, dt.Points(**cases), rtol=1e-12, derivatives=AXES)
    basin = dt.sweep(first_order, dt.Points(**cases), derivatives=AXES)
    for along in AXES:
        found, exact = basin.derivative(along), precise.derivative(along)
        assert np.median(np.abs(found - exact) / np.abs(exact)) < 1e-8
    assert np.all(basin.outcome == dt.sweep(first_order, dt.Points(**cases)).outcome)


@pytest.mark.slow
def test_single_starts_differentiate_in_every_way(cases):
    one = {name: values[60:61] for name, values in cases.items()}
    point = {name: float(values[0]) for name, values in one.items()}

    def value(delta):
        equation, omega0 = first_order(**(point | {"delta": delta}))
        return dt.residual_rotation(equation, omega0, rtol=1e-12)

    # Backwards, and forwards over that.
    program = jax.jit(lambda delta: jax.jvp(jax.grad(value), (delta,), (1.0,)))
    gradient, second = program(point["delta"])
    exact = complex_step(**one, along="delta")[0]
    np.testing.assert_allclose(gradient, exact, rtol=1e-8)

    # The second derivative by differences of complex steps.
    h = 1e-3
    around = {name: np.repeat(values, 6) for name, values in one.items()}
    around["delta"] = around["delta"] + h * SHIFTS
    slopes = complex_step(**around, along="delta")
    assert float(second) == pytest.approx(WEIGHTS @ slopes / h, rel=1e-7)


@pytest.mark.slow
def test_semi_reduced_level_against_high_order_differences():
    def problem(delta, phi):
        return dt.TransverseSemi(delta), dt.cylindrical(0.2, 0.15, phi)

    phi = np.linspace(-0.6, 0.3, 8)
    delta, h = np.linspace(-0.5, 0.4, 8), 2e-3
    points = dt.Points(delta=delta, phi=phi)
    found = dt.sweep(problem, points, rtol=1e-11, derivatives=["delta"]).derivative("delta")
    shifted = np.concatenate([delta + k * h for k in SHIFTS])
    around = dt.sweep(problem, dt.Points(delta=shifted, phi=np.tile(phi, 6)), rtol=1e-13)
    exact = WEIGHTS @ around.omega_inf.reshape(6, 8) / h
    np.testing.assert_allclose(found, exact, rtol=1e-8, atol=1e-8)


@pytest.mark.slow
def test_variations_of_a_general_body_are_those_of_the_closed_form():
    def tangent(equation_of, delta):
        equation, change = jax.jvp(equation_of, (delta,), (1.0,))
        parameters = jax.tree.map(lambda x: x[None], change)
        return Tangent(equation, parameters, jnp.array([[0.1, 0.2, -0.3]]), jnp.ones(()))

    @jax.jit
    def found(y):
        one = tangent(lambda d: dt.Reduced(dt.axisymmetric(d)), -0.3)
        two = tangent(dt.TransverseReduced, -0.3)
        y = two.lift(y)
        return [(top.lift(y[:3]), top(0.0, y), top.omega_inf_tangents(y)) for top in (one, two)]

    for one, two in zip(*found(jnp.array([0.2, 3e-6, 4e-6])), strict=True):
        np.testing.assert_allclose(one, two, rtol=1e-12)


class Held(Settling):
    """A body that stays as it is: the end of a run, without the run."""

    def __call__(self, t, y, args=None):
        return 0 * y

    def verdict(self, y):
        value = self.body.inertia[0, 0] * y[0]
        return Verdict(jnp.asarray(dt.Outcome.RESIDUAL), value, jnp.asarray(False))


@pytest.mark.slow
def test_no_derivative_along_changes_that_turn_the_dipole_off_its_axis():
    """Then ω∞ falls to 0. What keeps the dipole there, or turns all, has its derivative."""
    plain = jnp.diag(jnp.array([0.7, 1.1, 0.9]))

    @jax.jit
    def slopes(turn, along):
        c, s = jnp.cos(turn), jnp.sin(turn)
        turned = jnp.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

        def value(change):
            across = jnp.zeros((3, 3)).at[0, 1].set(change[1]).at[1, 0].set(change[1])
            inertia = plain + change[0] * jnp.diag(jnp.array([1.0, 0.0, 0.0])) + across
            dipole = jnp.array([0.9 + change[2], change[3], 0.0])
            body = dt.Body(turned @ inertia @ turned.T, turned @ dipole)
            return dt.residual_rotation(Held(body), jnp.array([0.2, 0.1, 0.1]))

        return jax.grad(value)(jnp.zeros(4)), jax.jvp(value, (jnp.zeros(4),), (along,))[1]

    kept, turning = jnp.array([2.0, 0.0, 1.0, 0.0]), jnp.array([0.0, 1.0, 0.0, 0.0])
    both = jnp.array([0.0, 1.0, 0.0, -1.0])  # the axis by 1/(J₁ − J₂), the dipole by −1
    gradient, slope = slopes(0.0, kept)
    np.testing.assert_allclose(gradient[::2], [0.2, 0.0], rtol=1e-14)
    assert np.all(gradient[1::2] > 1e290)
    assert float(slope) == pytest.approx(0.4, rel=1e-14)
    assert slopes(0.0, turning)[1] > 1e290
    assert abs(slopes(0.0, both)[1]) > 1e290
    # Of a body that lies askew, and so is aligned but for rounding.
    assert float(slopes(0.3, kept)[1]) == pytest.approx(0.4 * np.cos(0.3) ** 2, rel=1e-9)
    whole = 0.2 * (1.1 - 0.7) * np.sin(0.6)  # I₁₁ of the body as a whole turned further
    exact = [0.2 * np.cos(0.3) ** 2, np.inf, whole]
    np.testing.assert_allclose(along_the_way(0.3), exact, rtol=1e-9)


@jax.jit
def along_the_way(turn):
    """Variations of `Held` by I₁, by I₁₂, and by the angle, of a body turned about axis 3."""

    def held(first, second, more):
        c, s = jnp.cos(turn + more), jnp.sin(turn + more)
        turned = jnp.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        inertia = jnp.array([[0.7 + first, second, 0.0], [second, 1.1, 0.0], [0.0, 0.0, 0.9]])
        return Held(dt.Body(turned @ inertia @ turned.T, turned @ jnp.array([0.9, 0.0, 0.0])))

    made, push = jax.linearize(held, *jnp.zeros(3))
    tangent = Tangent(made, jax.vmap(push)(*jnp.eye(3)), jnp.zeros((3, 3)), jnp.ones(()))
    return tangent.omega_inf_tangents(tangent.lift(jnp.array([0.2, 0.1, 0.1])))


def test_slopes_where_the_value_is_known_at_once():
    # ω₃ = 0 keeps ω₁, yet ω∞ moves with ω₃: dω₁ = δ∫ω₂ dω₃ dτ, ω₂′ = −ω²ω₂,
    # dω₃′ = −(ω² + δ(2ω₁² − ω₂²))/(1−δ) dω₃; at δ = 0 dω₁/dδ = ∫ω₂ω₃dτ.
    w1, w2, d = 0.3, 0.4, -0.2

    def rate(t, y):
        s, axial, _ = y
        square = w1**2 + s**2
        third = -(square + d * (2 * w1**2 - s**2)) / (1 - d) * axial
        return [-square * s, third, d * s * axial]

    found = solve_ivp(rate, (0, 400), [w2, 1.0, 0.0], method="DOP853", rtol=1e-12, atol=1e-15)

    points = dt.Points(delta=[d, 0.0], w1=[w1, w1], w2=[w2, w2], w3=[0.0, 0.5])
    basin = dt.sweep(cartesian, points, rtol=1e-11, derivatives=("delta", "w2", "w3"))
    assert basin.derivative("w3")[0] == pytest.approx(found.y[2, -1], rel=1e-8)
    # sphere: ω₂ = ρ cos a, ω₃ = ρ sin a with ρρ′ = −ω²ρ², so ∫ρ² dτ = −½ ln(1 − ρ₀²/ω₀²)·…
    square = w2**2 + 0.5**2
    integral = w2 * 0.5 / square * np.log1p(square / w1**2) / 2
    assert basin.derivative("delta")[1] == pytest.approx(integral, rel=1e-8)


@pytest.mark.slow
def test_no_derivative_no_number():
    def slope(delta, omega, level=dt.TransverseReduced, **settings):
        columns = {f"w{k}": [w] for k, w in enumerate(omega, 1)}
        points = dt.Points(delta=[delta], **columns)

        def problem(delta, w1, w2, w3):
            return level(delta), jnp.stack([w1, w2, w3])

        basin = dt.sweep(problem, points, derivatives=("delta", "w2", "w3"), **settings)
        return basin.derivative("delta")[0]

    assert slope(-0.2, [0.1, 0.1, 0.9]) == 0.0  # turns to its stop
    assert slope(0.2, [0.0, 0.0, 0.5]) == 0.0  # axis 3: neighbours stop, or nearly
    assert np.isnan(slope(0.2, [0.0, 0.5, 0.0], dt.TransverseSemi))  # axis 2: a boundary
    assert np.isnan(slope(0.2, [0.01, 0.3, 0.3], max_steps=3))  # undecided
    assert np.isnan(slope(0.2, [1e200, 0.3, 0.3]))  # failed


INF = np.inf


@pytest.mark.slow
@pytest.mark.parametrize(
    ("x", "gradient", "infinite"),
    [
        # Of order 1, x = (δ, ω): first derivatives, and where second ones are infinite.
        ((-0.6, 0.3, 0.4, 0.0), [0, 1, 0, INF], [(0, 3), (1, 3), (2, 3), (3, 3)]),  # others stop
        ((-0.5, 0.3, 0.4, 0.0), [0, 1, 0, INF], [(0, 3), (1, 3), (2, 3), (3, 3)]),
        ((0.2, 0.0, 0.5, 0.0), [0, 1, 0, INF], [(0, 3), (1, 3), (2, 3), (3, 3)]),  # axis 2
        # The sphere keeps ω₁; else ω₁ grows by δ∫ω₂ω₃dτ, which diverges if ω₁ = 0.
        ((0.0, 0.0, 0.5, 0.4), [INF, 1, 0, 0], [(0, 0), (0, 1), (0, 2), (0, 3)]),
        ((0.0, 0.0, 0.0, 0.5), [0, 1, 0, 0], [(0, 2)]),
        # By (4.16) |ω∞| ~ (distance from axis 3)^1.2 at δ = 0.9, ^5.2 at 0.3.
        ((0.9, 0.0, 0.0, 0.5), [0, 0, 0, 0], [(1, 1), (1, 2), (2, 2)]),
        ((0.3, 0.0, 0.0, 0.5), [0, 0, 0, 0], []),
    ],
)
def test_infinite_only_along_changes_that_leave_what_keeps_the_residual_rotation(
    x, gradient, infinite
):
    np.testing.assert_array_equal(edges(x)[0], gradient)
    expected = np.zeros((4, 4), bool)
    for i, j in infinite:
        expected[i, j] = expected[j, i] = True
    by_hand = np.isinf(gradient)
    first, second = (np.asarray(each) for each in both_orders(jnp.array(x)))
    np.testing.assert_array_equal(first > 1e290, by_hand)
    np.testing.assert_array_equal(first[~by_hand], np.array(gradient)[~by_hand])
    # Of what is infinite, the derivatives are, too: nothing is known of them.
    np.testing.assert_array_equal(np.abs(second[~by_hand]) > 1e290, expected[~by_hand])
    assert np.all(second[by_hand] > 1e290)
    assert not np.any(second[~by_hand][~expected[~by_hand]])


@pytest.mark.slow
@pytest.mark.parametrize("start", [(0.3, 0.4, 0.0), (-0.3, 0.0, 0.0)])
def test_a_body_whose_line_attracts_nothing_keeps_its_value_beside_derivatives(start):
    """At order 1 and δ ≤ −1/2 nothing comes to the line: what is in the plane ω₃ = 0 stays there.

    Rounding would take a longer run off the plane.
    """

    def problem(delta, w1):
        return dt.Reduced(dt.axisymmetric(delta)), jnp.stack([w1, 0 * w1 + start[1], 0 * w1])

    points = dt.Points(delta=[-0.6, -0.5], w1=[start[0]] * 2)
    basin = dt.sweep(problem, points, derivatives=("w1",))
    np.testing.assert_array_equal(basin.outcome, dt.Outcome.RESIDUAL)
    np.testing.assert_array_equal(basin.omega_inf, start[0])
    assert basin.steps.max() == 0
    np.testing.assert_array_equal(basin.derivative("w1"), 1.0)


WHOLE = ("w1", "w2", "w3", "j1", "j2", "j3", "j12", "j23", "d2", "size", "turn")
HELD = [  # moments, start, angle by which all is turned, derivatives by these
    ((1.0, 1.0, 1.0), (0.0, 0.3, 0.4), 0.0, [1, 0, 0, 0, INF, INF, 0, INF, 0.3, 0, 0]),
    ((1.0, 1.0, 1.0), (0.0, 0.3, 0.4), 0.4, [1, 0, 0, 0, INF, INF, 0, INF, 0.3, 0, 0]),
    ((1.0, 0.8, 0.8), (0.0, 0.3, 0.4), 0.4, [1, 0, 0, 0, INF, INF, 0, INF, 0, 0, 0]),
    ((1.0, 0.8, 0.8), (0.0, 0.3, 0.0), 0.0, [1, 0, 0, 0, 0, 0, 0, INF, 0, 0, 0]),
    ((1.0, 1.0, 1.6), (0.3, 0.4, 0.0), 0.0, [1, 0, INF, INF, INF, 0, INF, INF, 0.4, 0, 0]),
    ((1.0, 1.0, 1.5), (0.3, 0.0, 0.0), 0.0, [1, 0, INF, 0, 0, 0, INF, 0, 0, 0, 0]),
    ((1.0, 1.0, 0.7), (0.0, 0.2, 0.0), 0.0, [1, 0, INF, 0, 0, 0, 0, INF, 0.2, 0, 0]),
    ((1.0, 1 + 1e-9, 0.7), (0.2, 0.0, 0.0), 0.0, [1, 0, 0, 0, 0, 0, INF, 0, INF, 0, 0]),
    ((0.1, 1.0, 1.05), (0.2, 0.0, 0.0), 0.9, [1, 0, 0, 0, 0, 0, INF, 0, INF, 0, 0]),
]


@pytest.mark.slow
def test_infinite_only_along_changes_that_leave_what_keeps_a_body_rotating():
    """Where J_a = J_b alone keeps w = 0, and where the plane of the paper's order does.

    A leaning dipole ends every residual rotation; where there is none, nothing changes.
    """

    def problem(start, j1, j2, j3, j12, j23, d2, size, turn, moments):
        across = jnp.zeros((3, 3)).at[1, 2].set(j23).at[2, 1].set(j23)
        across = across.at[0, 1].set(j12).at[1, 0].set(j12)
        q = rotation(turn)
        inertia = jnp.diag(moments + jnp.stack([j1, j2, j3])) + across
        body = dt.Body(q @ ((1 + size) * inertia) @ q.T, q @ jnp.stack([1 + 0 * d2, d2, 0 * d2]))
        return dt.Reduced(body), q @ start

    @jax.jit
    def known(moments, start, turn, directions):
        def of_all(x):
            return problem(x[:3], *x[3:], moments)

        x = jnp.concatenate([start, jnp.zeros(7), turn[None]])
        (equation, omega), push = jax.linearize(of_all, x)
        along = jax.vmap(push)(directions)
        assert equation.lift(omega) is omega  # a state is ω, so their variations are the same

        def changes(along, basis):
            tangent = Tangent(equation, *along, jnp.ones(()), basis=basis)
            return tangent.omega_inf_tangents(jnp.concatenate([omega, *along[1]]))

        # Directions do not know of each other, but the changes of a basis do.
        one_by_one = jax.vmap(lambda x: changes(jax.tree.map(lambda part: part[None], x), False))
        return equation.verdict(omega).slope, one_by_one(along)[:, 0], changes(along, True)

    def along(**parts):
        return sum(value * np.eye(11)[WHOLE.index(name)] for name, value in parts.items())

    one, lean = np.eye(11), WHOLE.index("d2")
    for moments, start, turn, expected in HELD:
        given = np.array(moments), np.array(start), np.array(turn)
        slope, found, alone = known(*given, one)
        assert float(slope) < 1e-40
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-15)
        # One start: of a body askew nothing is known of what takes the dipole off its axis, and
        # nothing of what else may come together with that.
        sure = np.array([name not in ("j12", "d2", "turn") for name in WHOLE])
        np.testing.assert_allclose(alone[sure], np.array(expected)[sure], rtol=1e-9, atol=1e-15)
        if not turn and moments[0] != moments[1]:
            assert np.isinf(alone[lean])
    # Together with a lean, ω₁ ends at 0, too; and 10⁻⁷ of one is a lean, rounding is not.
    at = np.array([1.0, 1.0, 0.7]), np.array([0.0, 0.2, 0.0]), np.array(0.0)
    ways = [along(w1=1, j12=1), along(w1=1, size=1), along(size=1, d2=1e-3)]
    *_, found, _ = known(*at, np.concatenate([ways, one[3:]]))
    np.testing.assert_allclose(found[:3], [0, 1, 2e-4], rtol=1e-14)
    at = np.array([1.0, 0.8, 0.7]), np.array([0.2, 0.0, 0.0]), np.array(0.4)
    ways = [along(size=1, d2=1e-7), along(size=1, d2=1e-15), along(w1=1, turn=3)]
    *_, found, _ = known(*at, np.concatenate([ways, one[3:]]))
    np.testing.assert_allclose(found[:3], [INF, 0, 1], rtol=1e-14, atol=1e-14)


def rotation(angle):
    """About (1, 1, 1)."""
    n = jnp.full(3, 3**-0.5)
    along, zero = n[:, None] * n[None], jnp.zeros(())
    across = jnp.stack([zero, -n[2], n[1], n[2], zero, -n[0], -n[1], n[0], zero]).reshape(3, 3)
    turned = jnp.cos(angle) * (jnp.eye(3) - along) + jnp.sin(angle) * across + along
    return jnp.where(angle == 0, jnp.eye(3), turned)


def edges(x):
    """First derivatives of a sweep."""
    names = ("delta", "w1", "w2", "w3")
    points = dt.Points(**{name: [value] for name, value in zip(names, x, strict=True)})
    basin = dt.sweep(cartesian, points, derivatives=names)
    return np.stack([basin.derivative(name) for name in names], axis=1)


@jax.jit
def both_orders(x):
    def value(x):
        return dt.residual_rotation(*cartesian(*x))

    return jax.grad(value)(x), jax.hessian(value)(x)


@pytest.mark.slow
@pytest.mark.parametrize("delta", [1.2, np.nan])
def test_bad_input_has_no_derivatives(delta):
    for found in both_orders(jnp.array([delta, 0.2, 0.02, 0.2])):
        assert np.all(np.isnan(found))


def test_the_power_beside_axis_3():
    """|ω∞| ~ ε^(q/(2 − q + p)) by (4.16): at `STEEP_FROM` it is ε²."""
    d = STEEP_FROM
    q, p = 2 / (1 + d**3), d * (1 - d) * (3 + 3 * d + d**2) / ((1 + 2 * d) * (1 + d**3))
    assert q / (2 - q + p) == pytest.approx(2, abs=1e-12)
    phi = np.linspace(0, np.pi, 60, endpoint=False)

    def problem(w_perp, phi):
        return dt.TransverseReduced(0.9), dt.cylindrical(w_perp, 0.5, phi)

    axes = {"w_perp": np.array([1e-2, 1e-3]), "phi": phi}
    basin = dt.sweep(problem, dt.Grid(**axes), rtol=1e-9, max_steps=100_000)
    far, near = np.max(np.abs(basin.omega_inf), axis=1)
    assert np.log10(far / near) == pytest.approx(1.2, abs=0.1)


@pytest.mark.slow
def test_on_the_boundary_there_is_no_derivative():
    def problem(phi):
        return dt.TransverseReduced(-0.2), dt.cylindrical(0.2, 0.2, phi)

    edge = 0.29626034320137482935  # from benchmarks.accuracy.stress

    def slopes(*phis):
        basin = dt.sweep(problem, dt.Points(phi=phis), derivatives=("phi",), rtol=1e-10)
        return basin.outcome, basin.derivative("phi")

    outcomes, found = slopes(edge + 1e-11, edge + 1e-8)  # the first one is too near to tell
    np.testing.assert_array_equal(outcomes, dt.Outcome.STOP)
    np.testing.assert_array_equal(found, [np.nan, 0.0])
    value, slope = jax.value_and_grad(lambda phi: dt.residual_rotation(*problem(phi)))(edge + 1e-11)
    assert float(value) == 0
    assert np.isnan(slope)


@pytest.mark.slow
@pytest.mark.parametrize(
    "moments",
    [
        (1.0, 1.0, 0.7),  # dipole across the axis of a top, along axis 1
        (1.0, 0.8, 1.0),
        (1.0, 0.9, 0.9),  # along the axis
        (1.0, 1.0, 1.0),
    ],
)
def test_derivatives_at_repeated_moments(moments):
    start, zero = jnp.array([0.199, 0.021, 0.2]), jnp.zeros(())

    def problem(change, j1, j2, j23):
        i1, i2, i23 = moments[0] + change * j1, moments[1] + change * j2, change * j23
        inertia = [[i1, zero, zero], [zero, i2, i23], [zero, i23, zero + moments[2]]]
        inertia = jnp.stack([jnp.stack(row) for row in inertia])
        return dt.SemiReduced(dt.Body(inertia, jnp.array([1.0, 0.0, 0.0]))), start

    def swept(changes, **settings):
        j1, j2, j23 = np.repeat(np.eye(3), len(changes), axis=1)  # one after the other
        points = dt.Points(change=np.tile(changes, 3), j1=j1, j2=j2, j23=j23)
        return dt.sweep(problem, points, progress=False, **settings)

    step = 4e-4
    exact = swept(step * SHIFTS, rtol=1e-13).omega_inf.reshape(3, 6) @ WEIGHTS / step
    found = swept([0.0], rtol=1e-8, derivatives="change").derivative("change")
    np.testing.assert_allclose(found, exact, rtol=1e-7, atol=1e-9)


def test_only_derivatives_that_there_are_can_be_read():
    points = dt.Points(delta=[0.1], w_perp=[0.1], w3=[0.2], phi=[0.3])
    for names, message in (([], "had none"), (["w3"], "sweep, w3")):
        basin = dt.sweep(first_order, points, derivatives=names)
        with pytest.raises(ValueError, match=f"`axis` must be among .* {message}, but is 'phi'"):
            basin.derivative("phi")


@pytest.mark.slow
def test_decay_times_and_their_slopes():
    """Spin about axis 2 obeys (2.4): E falls to (1 − share) when 2ω₀²τ = share/(1 − share)."""

    @jax.jit
    def times(delta, start, share):
        def time(share):
            return decay_time(dt.TransverseReduced(delta), start, share)

        return jax.value_and_grad(time)(share)

    across, for_ever, nan = (0.0, 0.5, 0.0), (0.2, 0.0, 0.0), np.nan
    rows = [(0.3, across, 0.75), (0.3, for_ever, 0.5), (1.2, across, 0.5), (nan, across, 0.5)]
    rows += [(0.3, across, 1.2), (0.3, across, nan)]
    found = [times(*(jnp.array(part) for part in row)) for row in rows]
    values, slopes = np.array(found).T
    assert float(values[0]) == pytest.approx(6.0, rel=1e-9)
    assert float(slopes[0]) == pytest.approx(32.0, rel=1e-7)  # 2/(1 − share)²
    assert np.all(np.isnan(values[1:]))
    assert np.all(np.isnan(slopes[1:]))


@pytest.mark.slow
def test_the_residual_rotation_keeps_its_energy():
    """At order 1 with ω₃ = 0, u = ω₂² obeys u′ = −2(ω₁² + u)u, and ω₁ is constant."""
    w1, w2, share = 0.3, 0.4, 0.5
    u, rest = w2**2, w1**2
    left = (1 - share) * u
    exact = np.log(u / (rest + u) * (rest + left) / left) / (2 * rest)
    found = decay_time(dt.TransverseReduced(0.3), [w1, w2, 0.0], share)
    assert float(found) == pytest.approx(exact, rel=1e-9)
