"""Stationary laws against quadratures of the same law by mpmath, moments, and limits."""

import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest

from dipoletop.noise import grain_density, mean_square, rotator_density

# κ = I = 1: Γ, θ_g, θ and ⟨ω²⟩ in one and in three dimensions
ROTATORS = [
    (1.0, 1.0, 0.01, 0.4717943174, 1.149567708),
    (1.0, 1.0, 0.25, 0.574401397, 1.490942841),
    (0.1, 2.0, 0.5, 0.6284342409, 1.718251278),
    (1.0, 0.25, 1.0, 0.6497165793, 2.384783162),
]
# F = G = 1: τ_H/τ_ed, ⟨y²⟩, ⟨y⁴⟩
GRAINS = [
    (0.0, 3.0, 15.0),
    (1.0, 1.651672135, 4.044983596),
    (10.0, 0.6994405771, 0.6901678269),
    (1000.0, 0.07982071341, 0.00876053786),
]


@pytest.mark.parametrize(("drag", "drag_heat", "heat", "plane", "space"), ROTATORS)
def test_rotators_in_two_baths(drag, drag_heat, heat, plane, space):
    given = {"drag": drag, "drag_heat": drag_heat, "heat": heat}
    np.testing.assert_allclose(mean_square(**given), plane, rtol=1e-9)
    np.testing.assert_allclose(mean_square(dimensions=3, **given), space, rtol=1e-9)

    def law(w):
        a = mp.mpf(heat) / (drag * drag_heat)
        log = mp.log1p(a * w**2) * drag / heat * (1 - mp.mpf(drag_heat) / heat)
        return mp.exp(-(w**2 / heat + log) / 2)

    whole = 2 * mp.quad(law, [0, 1, 4, 20])
    w = np.array([0.1, 1.3])
    expected = [float(law(x) / whole) for x in w]
    np.testing.assert_allclose(rotator_density(jnp.asarray(w), **given), expected, rtol=1e-10)


def test_limits():
    w = jnp.linspace(0.0, 3.0, 7)
    maxwell = np.exp(-(np.asarray(w) ** 2) / 2) / np.sqrt(2 * np.pi)
    for given in ({"kappa": 0.0}, {"heat": 1.0}):
        np.testing.assert_allclose(rotator_density(w, **given), maxwell, rtol=1e-12)
    # Without thermal radiation ln f = −½(ω² + κω⁴/2Γ).
    cold, nearly = (mean_square(heat=heat, kappa=3.0) for heat in (0.0, 1e-9))
    np.testing.assert_allclose(cold, nearly, rtol=1e-8)


@pytest.mark.parametrize(("ratio", "second", "fourth"), GRAINS)
def test_grains(ratio, second, fourth):
    nodes, weights = np.polynomial.legendre.leggauss(400)
    end = 12.0 / (1 + ratio) ** 0.25
    y, weights = end * (1 + nodes) / 2, end * weights / 2
    density = np.asarray(grain_density(jnp.asarray(y), ratio=ratio))
    np.testing.assert_allclose(density @ weights, 1.0, rtol=1e-11)
    np.testing.assert_allclose((density * y**2) @ weights, second, rtol=1e-9)
    np.testing.assert_allclose((density * y**4) @ weights, fourth, rtol=1e-9)


@pytest.mark.parametrize(
    ("drag", "excitation", "ratio", "expected"),
    [
        (9.301, 28.780, 2.2558e10 / 1.3713e7, 0.33212),
        (6.057, 8.652, 2.5174e10 / 2.4878e10, 3.32669),
    ],
)
def test_grains_of_a_cold_cloud(drag, excitation, ratio, expected):
    nodes, weights = np.polynomial.legendre.leggauss(400)
    y = 6.0 * (1 + nodes)
    given = {"drag": drag, "excitation": excitation, "ratio": ratio}
    density = np.asarray(grain_density(jnp.asarray(y), **given))
    np.testing.assert_allclose(6 * (density * y**2) @ weights, expected, rtol=1e-5)


def test_refusals():
    for call, sentence in {
        "rotator_density(-1.0, dimensions=3)": "`omega` must not be negative",
        "rotator_density(1.0, dimensions=2)": "`dimensions` must be 1 or 3, but is 2",
        "mean_square(heat=-1.0)": "`heat` must not be negative",
        "mean_square(drag=0.0)": "`drag` must be positive",
        "grain_density(1.0, excitation=0.0)": "`excitation` must be positive",
    }.items():
        with pytest.raises(ValueError, match=f"Argument {sentence}"):
            eval(call)
