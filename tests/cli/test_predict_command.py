"""`dipoletop predict`: exact results of symmetric particles, what is written."""

import math
import re

import numpy as np
import pytest

from command_line import invoke, said, table
from dipoletop.cli import particle_commands


def number(text, name):
    """The first number behind a name."""
    return float(re.search(rf"\b{name}=(\S+?)[\s;)]", text)[1])


def kappa(debye):
    """d²/(6πε₀c³) in SI units."""
    return (debye * 3.33564095e-30) ** 2 / (6 * math.pi * 8.8541878128e-12 * 299792458.0**3)


# The fibre of cellulose: its moment across, and the time unit of its motion at 1 GHz.
LONG, ACROSS = 2 * 30**2, 300**2 + 30**2
UNIT = 1600 * 27e-23 * ACROSS * 1e-18 / 12 / kappa(4000) / (2e9 * math.pi) ** 2


def half_time(square):
    """With w = L⊥² and L∥² = c, w′ = −(2κ/I₁³)(w + c)w, and E − E∞ = w/(2I₁); c is `square`."""
    h = (1 - square) + square * ACROSS / LONG  # hI₁
    return UNIT * h**2 * np.log1p(square) / (2 * square)


@pytest.mark.slow
def test_a_fibre_with_a_given_start(tmp_path):
    start = ["--momentum", "1,2,3", "--spin", "1GHz"]
    text = said("predict", "--particle", "cellulose", *start, "--output", f"{tmp_path}/s.svg")
    assert "dipole=4000 D along (1, 0, 0)" in text
    assert "RESIDUAL; POSITIVE; " in text
    assert number(text, "ratio") == pytest.approx(1 / math.sqrt(14), rel=1e-6)
    assert number(text, "half_time") == pytest.approx(half_time(1 / 14), rel=1e-3)
    assert number(text, "lifetime") == math.inf
    lost = 13 / (13 + ACROSS / LONG)
    assert f"J; {lost:.6g} of E₀" in text
    first, *_, last = (float(row["energy_J"]) for row in table(tmp_path / "s.csv"))
    assert last / first == pytest.approx(1 - lost, rel=1e-2)
    assert (tmp_path / "s.svg").stat().st_size > 10_000


@pytest.mark.slow
def test_a_fibre_from_isotropic_directions(tmp_path):
    """A dipole along the axis of symmetry leaves L∥: L∞/L₀ = |cos θ|, uniform from 0 to 1."""
    text = said("predict", "--particle", "cellulose", "--directions", 30, "--output", tmp_path)
    shares = re.search(r"ratio=(\S+) on average \((\S+), (\S+), (\S+)\)", text).groups()
    np.testing.assert_allclose([float(x) for x in shares], [0.5, 0.1, 0.5, 0.9], atol=0.06)
    assert number(text, "lifetime") == math.inf
    rows = table(tmp_path / "prediction.csv")
    directions = np.array([[float(row[f"L_{k}"]) for k in "xyz"] for row in rows])
    ratios = [float(row["ratio"]) for row in rows]
    np.testing.assert_allclose(ratios, np.abs(directions[:, 0]), rtol=1e-9)
    times = np.array([float(row["half_time"]) for row in rows])
    np.testing.assert_allclose(times, half_time(directions[:, 0] ** 2), rtol=1e-6)
    assert number(text, "half_time") == pytest.approx(np.sort(times)[2], rel=1e-3)
    assert (tmp_path / "prediction.png").stat().st_size > 10_000


@pytest.mark.slow
def test_a_tilted_dipole_stops_after_its_lifetime(tmp_path):
    """L² = L²ₚ/(1 + t/T) with T = J₃/(2κε²Ωₚ²), at the plateau of a dipole ε = 0.001 off axis 3."""
    solid = ["--box", "100x60x40nm", "--density", 2000, "--dipole", 2400]
    arguments = ["predict", *solid, "--momentum", "1,1,1", "--output", tmp_path / "t", "--along"]
    aligned, tilted = (said(*arguments, along) for along in ("0,0,1", "0,0.001,1"))
    assert "Prediction(RESIDUAL;" in aligned
    assert "Prediction(STOP;" in tilted
    moment = 2000 * 24e-23 * (100**2 + 60**2) * 1e-18 / 12
    kept = number(aligned, "ratio")
    # L₀ = spin/h₀, h₀ = (p₁ + p₂ + p₃)/3 along (1, 1, 1).
    moments = 2000 * 24e-23 / 12 * 1e-18 * np.array([60**2 + 40**2, 100**2 + 40**2, 100**2 + 60**2])
    plateau = kept * 2e9 * math.pi / np.mean(1 / moments) / moment
    lifetime = moment / (2 * kappa(2400) * 1e-6 * plateau**2)
    assert number(tilted, "lifetime") == pytest.approx(lifetime, rel=3e-3)


def test_solids_have_the_mass_of_their_size(monkeypatch, tmp_path):
    """The sizes are edges and diameters; nothing is predicted here."""
    seen = []
    monkeypatch.setattr(particle_commands, "_predictions", lambda one, *_: seen.append(one))
    rest = ["--density", 1000, "--dipole", 5, "--along", "x", "--output"]
    for shape in (
        "--box 4x2x1nm",
        "--rod 4nmx2nm",
        "--sphere 2nm",
        "--ellipsoid 0.004x2e-3x2e-3um",
    ):
        invoke("predict", *shape.split(), *rest, tmp_path / "p")
    masses = [float(particle.mass) for particle in seen]
    volumes = np.array([8, 4 * np.pi, 4 / 3 * np.pi, 8 / 3 * np.pi])
    np.testing.assert_allclose(masses, 1e-24 * volumes, rtol=1e-12)


# dipoletop balance


def test_balance_of_the_particles_of_the_paper():
    text = said("balance", "--pressure", 1e-7, "--loss", 0.1)
    assert text.count("the gas brakes most") == 6
    assert (
        "DAST about the short axis: Balance(Ω=6.28e+09 rad/s; the gas brakes most, 254 times"
        in text
    )


def test_balance_of_a_solid(tmp_path):
    """A rod at rest in a gas of 1e-9 mbar: Γ/Φ and the mass of its molecules give the rate."""
    rod = ["--rod", "300x30nm", "--density", 1600, "--dipole", 4000, "--along", "x", "--axis", "z"]
    text = said("balance", *rod, "--pressure", 1e-7, "--output", tmp_path / "b.svg")
    flux = 1e-7 * math.sqrt(28.97 * 1.66053906892e-27 / (2 * math.pi * 1.380649e-23 * 300))
    mass = 1600 * math.pi * 15e-9**2 * 300e-9
    rate = flux * 6.5208e-30 / (mass * 15e-9**2 / 2)
    assert f"gas        {rate:.3g} 1/s" in text
    assert "blackbody  not known: `loss` is not given" in text
    assert (tmp_path / "b.svg").stat().st_size > 10_000
