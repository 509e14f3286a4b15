"""Bodies: inertia by quadrature over their volume, refusals word by word, transformations."""

import itertools
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dipoletop as dt
from dipoletop.bodies import Body, axisymmetric, box, from_charges, rod, spheroid

RNG = np.random.default_rng(3)
X = [1.0, 0.0, 0.0]
IDENTITY = np.eye(3)


def rotated(moments, seed=5):
    """An inertia tensor with these principal moments along skew axes."""
    axes, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    tensor = axes @ np.diag(moments) @ axes.T
    return (tensor + tensor.T) / 2


def gauss(low, high, n=4):
    """Gauss–Legendre nodes and weights on [low, high]; exact to degree 2n − 1."""
    nodes, weights = np.polynomial.legendre.leggauss(n)
    return low + (high - low) * (nodes + 1) / 2, weights * (high - low) / 2


ANGLES = 2 * np.pi * np.arange(6) / 6, np.full(6, 2 * np.pi / 6)


def cloud(rules, position, jacobian):
    """Points and volumes of a product of quadrature rules in curvilinear coordinates."""
    points, volumes = [], []
    for nodes in itertools.product(*(zip(*rule, strict=True) for rule in rules)):
        u, weights = zip(*nodes, strict=True)
        points.append(position(*u))
        volumes.append(np.prod(weights) * jacobian(*u))
    return np.array(points), np.array(volumes)


def box_cloud(lengths):
    # As many points as in the other clouds, so that these compile once.
    edges = [gauss(-x / 2, x / 2, n) for x, n in zip(lengths, (4, 4, 6), strict=True)]
    return cloud(edges, lambda x, y, z: (x, y, z), lambda x, y, z: 1)


def spheroid_cloud(a, c):
    def position(s, mu, phi):
        rho = a * s * np.sqrt(1 - mu**2)
        return rho * np.cos(phi), rho * np.sin(phi), c * s * mu

    return cloud([gauss(0, 1), gauss(-1, 1), ANGLES], position, lambda s, mu, phi: a * a * c * s**2)


def rod_cloud(length, radius):
    return cloud(
        [gauss(0, radius), ANGLES, gauss(-length / 2, length / 2)],
        lambda r, phi, z: (r * np.cos(phi), r * np.sin(phi), z),
        lambda r, phi, z: r,
    )


@pytest.mark.parametrize(
    ("body", "points", "volume"),
    [
        (box(1.7, [0.8, 1.9, 3.1], X), box_cloud([0.8, 1.9, 3.1]), 0.8 * 1.9 * 3.1),
        (
            spheroid(1.7, 0.9, 2.3, dipole=X),
            spheroid_cloud(0.9, 2.3),
            4 / 3 * np.pi * 0.9**2 * 2.3,
        ),
        (spheroid(1.7, 2.3, 0.4, dipole=X), spheroid_cloud(2.3, 0.4), 4 / 3 * np.pi * 2.3**2 * 0.4),
        (rod(1.7, 3.0, 0.2, dipole=X), rod_cloud(3.0, 0.2), np.pi * 0.2**2 * 3.0),
    ],
)
def test_homogeneous_bodies_are_clouds_of_masses(body, points, volume):
    where, volumes = points
    assert volumes.sum() == pytest.approx(volume, rel=1e-13)
    masses = 1.7 * volumes / volumes.sum()
    # any charges will do: those proportional to the mass times x give the dipole Σ m x ρ
    parts = from_charges(masses, where + np.array([5.0, -4.0, 3.0]), masses * where[:, 0])
    size = np.trace(body.inertia)
    np.testing.assert_allclose(body.inertia, parts.inertia, rtol=0, atol=1e-12 * size)
    assert parts.dipole[0] == pytest.approx(np.trace(body.inertia) / 2 - body.inertia[0, 0])
    np.testing.assert_array_equal(body.dipole, X)


def test_inertia_is_that_of_point_masses():
    masses, where = RNG.uniform(1, 2, 7), RNG.normal(size=(7, 3))
    rho = where - masses @ where / masses.sum()
    expected = sum(m * (r @ r * np.eye(3) - np.outer(r, r)) for m, r in zip(masses, rho))  # noqa: B905
    body = from_charges(masses, where, np.ones(7))
    np.testing.assert_allclose(body.inertia, expected, rtol=1e-13)


def test_dipole_of_a_neutral_body_needs_no_centre():
    masses, where, charges = RNG.uniform(1, 2, 7), RNG.normal(size=(7, 3)), RNG.normal(size=7)
    charges -= charges.mean()
    body = from_charges(masses, where + 2.0, charges)
    np.testing.assert_allclose(body.dipole, charges @ where, rtol=1e-12)


def test_dipole_of_a_charged_body_is_about_the_centre_of_mass():
    where = np.array([[0.0, 0, 0], [2, 0, 0], [2, 3, 0], [2, 0, 3]])
    body = from_charges([3.0, 1, 1, 1], where, [0.0, 1, 0, 0])
    np.testing.assert_allclose(body.dipole, [1, -0.5, -0.5], rtol=1e-14)


@pytest.mark.parametrize("delta", [-1, -0.2, 0, 0.9999])
def test_axisymmetric_moments(delta):
    body = axisymmetric(delta)
    np.testing.assert_array_equal(body.inertia, np.diag([1, 1, 1 - delta]))
    np.testing.assert_array_equal(body.moments, sorted([1, 1, 1 - delta]))
    np.testing.assert_array_equal(body.dipole, X)


@pytest.mark.parametrize(
    ("dipole", "direction"), [("longitudinal", [0, 0, 1]), ([0, 3, 4], [0, 0.6, 0.8])]
)
def test_axisymmetric_dipole_has_length_one(dipole, direction):
    np.testing.assert_allclose(axisymmetric(0.1, dipole).dipole, direction, rtol=1e-15)


@pytest.mark.parametrize("scale", [1e-60, 1.0, 1e60])
@pytest.mark.parametrize(
    "moments", [(1, 1, 2), (1, 2, 3), (1e-9, 1, 1), (3, 4, 5), (1e-9, 1, 1 + 1e-9), (1e-13, 1, 1)]
)
def test_every_possible_body_is_accepted(moments, scale):
    # discs and thin rods included, along the axes and along skew ones, where numbers are rounded
    for tensor in (np.diag(moments), rotated(moments)):
        body = Body(scale * tensor, X)
        np.testing.assert_allclose(body.moments, scale * np.array(moments), atol=3e-15 * scale)


def test_inertia_is_made_exactly_symmetric():
    tensor = rotated((3, 4, 5))
    tensor[0, 1] *= 1 + 5e-13
    body = Body(tensor, X)
    np.testing.assert_array_equal(body.inertia, body.inertia.T)
    assert body.inertia[0, 1] == pytest.approx((tensor[0, 1] + tensor[1, 0]) / 2, rel=1e-15)


LINE = "be positive definite (masses on one line have a principal moment of zero)"
TRIANGLE = "have principal moments with J1 + J2 >= J3"
DIRECTIONS = 'be "transverse", "longitudinal" or a vector'
FRONT = ", or one batch axis in front"
SKEW = [[1, 0.25, 0], [0.5, 1, 0], [0, 0, 1]]
LINEAR = [[0, 0, 0], [1, 1, 1], [3, 3, 3]]
MASSES = "be non-negative and not all zero"
MESSAGES = [
    (lambda: Body(SKEW, X), "inertia", "be symmetric", "has 0.25, 0.5"),
    (lambda: Body(np.diag([1, 1, 2 + 1e-11]), X), "inertia", TRIANGLE, "has 1, 1, 2"),
    (lambda: Body([np.eye(3), np.diag([1.0, 4, 1])], X), "inertia", TRIANGLE, "has 1, 1, 4"),
    (lambda: Body(np.diag([0, 1, 1]), X), "inertia", LINE, "has 0, 1, 1"),
    (lambda: Body(np.diag([1, -1, 1]), X), "inertia", LINE, "has -1, 1, 1"),
    (lambda: Body(np.diag([1, 1, np.nan]), X), "inertia", "be finite", "has nan"),
    (lambda: Body(np.diag([1, 1, np.inf]), X), "inertia", "be finite", "has inf"),
    (lambda: Body(np.eye(2), X), "inertia", f"have shape (3, 3){FRONT}", "has shape (2, 2)"),
    (lambda: Body(1.0, X), "inertia", f"have shape (3, 3){FRONT}", "has shape ()"),
    (lambda: Body(None, X), "inertia", "be a real array of shape (3, 3)", "is None"),
    (lambda: Body(1j * IDENTITY, X), "inertia", "be a real array of shape (3, 3)", "has dtype"),
    (lambda: Body(IDENTITY, [0, 0, 0]), "dipole", "not be zero", "has 0, 0, 0"),
    (lambda: Body(IDENTITY, [0, 0, np.nan]), "dipole", "be finite", "has nan"),
    (lambda: Body(IDENTITY, [0, 1]), "dipole", f"have shape (3,){FRONT}", "has shape (2,)"),
    (lambda: Body(IDENTITY, "x"), "dipole", "be a real array of shape (3,)", "is 'x'"),
    (
        lambda: Body([IDENTITY] * 4, [X] * 3),
        "dipole",
        "have the batch size 4 of `inertia`",
        "has 3",
    ),
    (lambda: axisymmetric(1), "delta", "satisfy -1 <= delta < 1", "is 1.0"),
    (lambda: axisymmetric([0, 2.0]), "delta", "satisfy -1 <= delta < 1", "has 2"),
    (lambda: axisymmetric(np.nan), "delta", "be finite", "is nan"),
    (lambda: axisymmetric("oblate"), "delta", "be a real number", "is 'oblate'"),
    (lambda: axisymmetric(10**40), "delta", "be a real number", "is 1000"),
    (lambda: axisymmetric(True), "delta", "be a real number", "has dtype bool"),
    (lambda: axisymmetric(0, "radial"), "dipole", DIRECTIONS, "is 'radial'"),
    (lambda: axisymmetric(0, [0, 0, 0]), "dipole", "not be zero", "has 0, 0, 0"),
    (lambda: spheroid(0, 1, 1, dipole=X), "mass", "be positive", "is 0.0"),
    (lambda: spheroid(1, -1, 1, dipole=X), "a", "be positive", "is -1.0"),
    (lambda: spheroid(1, 1, 0, dipole=X), "c", "be positive", "is 0.0"),
    (lambda: box(-1, [1, 1, 1], X), "mass", "be positive", "is -1.0"),
    (lambda: box(1, [1, 0, -1], X), "lengths", "be positive", "has 0, -1"),
    (lambda: rod(-1, 1, 1, dipole=X), "mass", "be positive", "is -1.0"),
    (lambda: rod(1, 0, 1, dipole=X), "length", "be positive", "is 0.0"),
    (lambda: rod(1, 1, 0, dipole=X), "radius", "be positive", "is 0.0"),
    (lambda: rod([1, 1], 1, [1, 1, 1], dipole=X), "radius", "have the batch size 2 of", "has 3"),
    (lambda: from_charges([1] * 3, LINEAR, [1, 2, 0]), "inertia", LINE, "has "),
    (lambda: from_charges([1, -1, 1], IDENTITY, X), "masses", MASSES, "has -1"),
    (lambda: from_charges([0, 0, 0], IDENTITY, X), "masses", MASSES, "has 0, 0, 0"),
    (lambda: from_charges(1, np.eye(3), X), "masses", f"have shape (n,){FRONT}", "has shape ()"),
    (lambda: from_charges([1, 1], IDENTITY, X), "positions", f"have shape (2, 3){FRONT}", "has"),
    (lambda: from_charges([1] * 3, IDENTITY, [1]), "charges", f"have shape (3,){FRONT}", "has"),
]


@pytest.mark.parametrize(("make", "name", "must", "was"), MESSAGES)
def test_refusals(make, name, must, was):
    sentence = re.escape(f"Argument `{name}` must {must}") + ".*, but " + re.escape(was)
    with pytest.raises(ValueError, match=f"^{sentence}") as caught:
        make()
    assert str(caught.value).endswith(".")


def test_a_skew_line_of_masses_is_refused_whatever_its_rounding():
    # its smallest moment is a rounding error, of either sign
    lines = jnp.stack([jnp.asarray(rotated((0, 1, 1), seed)) for seed in range(40)])
    assert np.linalg.eigvalsh(lines)[:, 0].max() > 0
    made = jax.jit(jax.vmap(lambda tensor: Body(tensor, X)))(lines)
    assert np.isnan(made.inertia).all()


def test_a_traced_bad_inertia_becomes_nan():
    diagonal = [(1, 1, 2.5), (0.0, 1, 1), (-1, -1, -1), (1, np.nan, 1)]
    bad = [SKEW, rotated((0, 1, 1)), rotated((1, 1, 2.001)), *map(np.diag, diagonal)]
    made = jax.jit(jax.vmap(lambda tensor: Body(tensor, X)))(jnp.array(bad, float))
    assert np.isnan(made.inertia).any(axis=(1, 2)).all()
    np.testing.assert_array_equal(made.dipole, [X] * len(bad))


@pytest.mark.parametrize(
    ("make", "good", "bad"),
    [
        (lambda v: Body(IDENTITY, v).dipole, np.array(X), np.zeros(3)),
        (lambda v: Body(IDENTITY, v).dipole, np.array(X), np.array([1, np.inf, 0])),
        (lambda v: axisymmetric(0, v).dipole, np.array(X), np.zeros(3)),
        (lambda v: axisymmetric(v).inertia, -1.0, 1.0),
        (lambda v: spheroid(v, 1, 1, dipole=X).inertia, 1.0, 0.0),
        (lambda v: box(1, v, X).inertia, np.ones(3), np.array([1.0, -1, 1])),
        (lambda v: rod(1, 1, v, dipole=X).inertia, 1.0, -1.0),
        (lambda v: from_charges(v, np.eye(3), X).inertia, np.ones(3), np.zeros(3)),
    ],
)
def test_a_traced_bad_value_becomes_nan_in_its_lane_alone(make, good, bad):
    lanes = jax.jit(jax.vmap(make))(jnp.stack([jnp.asarray(good), jnp.asarray(bad)]))
    np.testing.assert_array_equal(lanes[0], make(good))
    assert np.isnan(lanes[1]).any()


def test_one_batch_axis_in_front():
    deltas = jnp.array([-0.5, 0.0, 0.25])
    bodies = axisymmetric(deltas, "longitudinal")
    assert bodies.inertia.shape == (3, 3, 3)
    assert bodies.dipole.shape == (3, 3)
    for lane, delta in enumerate(deltas):
        single = axisymmetric(delta, "longitudinal")
        np.testing.assert_array_equal(bodies.inertia[lane], single.inertia)
        np.testing.assert_array_equal(bodies.dipole[lane], single.dipole)
        np.testing.assert_array_equal(bodies.moments[lane], single.moments)


def test_derivatives_of_the_closed_forms():
    m, a, c = 1.3, 0.7, 2.1
    moments = jax.jit(
        jax.jacrev(lambda v: jnp.diagonal(spheroid(v[0], v[1], v[2], dipole=X).inertia)[1:])
    )
    transverse, about_axis = moments(jnp.array([m, a, c]))
    np.testing.assert_allclose(transverse, [(a**2 + c**2) / 5, 0.4 * m * a, 0.4 * m * c])
    np.testing.assert_allclose(about_axis, [0.4 * a**2, 0.8 * m * a, 0], atol=1e-15)
    assert jax.jit(jax.grad(lambda delta: axisymmetric(delta).inertia[2, 2]))(0.3) == -1
    slopes = jax.jit(jax.grad(lambda v: box(12.0, v, X).inertia[0, 0]))(jnp.array([1.0, 2, 3]))
    np.testing.assert_allclose(slopes, [0, 4, 6], rtol=1e-14)
    slope = jax.jit(jax.grad(lambda radius: rod(1.0, 2.0, radius, dipole=X).inertia[2, 2]))(0.3)
    assert slope == pytest.approx(0.3, rel=1e-14)


def test_derivatives_of_a_cloud():
    masses, where, charges = RNG.uniform(1, 2, 4), RNG.normal(size=(4, 3)), RNG.normal(size=4)

    @jax.jit
    @jax.jacrev
    def slopes(r):
        body = from_charges(masses, r, charges)
        return body.dipole, jnp.trace(body.inertia)

    of_dipole, of_trace = slopes(jnp.asarray(where))
    # ∂d/∂r of one charge is q − Qm/M along r: the centre of mass moves with it
    per_charge = charges - charges.sum() * masses / masses.sum()
    expected = np.einsum("n,cd->cnd", per_charge, np.eye(3))
    np.testing.assert_allclose(of_dipole, expected, rtol=1e-12, atol=1e-14)
    # ∂ tr I/∂r = 4 m ρ
    rho = where - masses @ where / masses.sum()
    np.testing.assert_allclose(of_trace, 4 * masses[:, None] * rho, rtol=1e-12)


def test_lists_may_mix_traced_and_plain_numbers():
    make = jax.jit(lambda x: Body([[1, 0, 0], [0, 1, 0], [0, 0, x]], [x, 0, 0.0]))
    np.testing.assert_array_equal(make(1.5).inertia, np.diag([1, 1, 1.5]))
    np.testing.assert_array_equal(make(1.5).dipole, [1.5, 0, 0])


def test_what_is_shown_are_the_numbers():
    assert repr(dt.TransverseReduced(-0.2, order=2)) == "TransverseReduced(delta=-0.2, order=2)"
    assert "dipole=[0.0, 0.0, 1.0]" in repr(dt.Body(np.eye(3), [0.0, 0.0, 1.0]))
    many = jax.vmap(dt.TransverseSemi)(jnp.linspace(-0.5, 0.5, 10))
    assert repr(many) == "TransverseSemi(delta=f64[10])"
    shown = []
    jax.jit(lambda d: shown.append(repr(dt.TransverseSemi(d))))(0.1)
    assert shown == ["TransverseSemi(delta=f64[])"]
