"""`dipoletop predict`: exact results of symmetric particles, tables, data, refusals."""

import csv
import math
import re

import numpy as np
import pytest
from command_line import invoke, refusal

from dipoletop.cli.prediction_tables import duration, quantiles_of


def read(path):
    with path.open() as lines:
        return list(csv.DictReader(lines))


def line(text, name):
    (found,) = [each for each in text.splitlines() if each.startswith(name)]
    return found[18:].split()


def kappa(debye):
    """d²/(6πε₀c³) in SI units."""
    return (debye * 3.33564095e-30) ** 2 / (6 * math.pi * 8.8541878128e-12 * 299792458.0**3)


def test_a_sphere_with_a_given_start(tmp_path):
    """Exactly: Ω∥ is kept, and E halves at T ln(1 + c²)/(2c²), T = 1.775e15 s in the paper."""
    start = ["--momentum", "1,2,3", "--spin", "1GHz"]
    result = invoke("predict", "--particle", "silica", *start, "--output", f"{tmp_path}/s.svg")
    assert result.exit_code == 0, result.output
    assert "dipole 2402 D" in result.output
    assert line(result.output, "outcome") == ["residual", "rotation"]
    assert float(line(result.output, "L∞/L₀")[0]) == pytest.approx(1 / math.sqrt(14), rel=1e-6)
    omega_inf = 2e9 * math.pi / math.sqrt(14)
    assert float(line(result.output, "ω∞")[0]) == pytest.approx(omega_inf, rel=1e-5)
    half_time = 1.775e15 / 2 * 14 * math.log(15 / 14)
    assert float(line(result.output, "half time")[0]) == pytest.approx(half_time, rel=1e-3)
    rows = read(tmp_path / "s.csv")
    first, last = (float(rows[k]["energy_J"]) for k in (0, -1))
    assert last / first == pytest.approx(1 / 14, rel=1e-2)
    assert (tmp_path / "s.svg").stat().st_size > 10_000


def test_a_fibre_from_isotropic_directions(tmp_path):
    """A dipole along the axis of symmetry leaves L∥: L∞/L₀ = |cos θ|, uniform from 0 to 1."""
    result = invoke("predict", "--particle", "cellulose", "--directions", 60, "--output", tmp_path)
    assert result.exit_code == 0, result.output
    shares = [float(cell) for cell in line(result.output, "L∞/L₀")]
    np.testing.assert_allclose(shares, [0.5, 0.1, 0.5, 0.9], atol=0.04)
    assert line(result.output, "lifetime") == ["∞"]
    rows = read(tmp_path / "prediction.csv")
    directions = np.array([[float(row[f"L_{k}"]) for k in "xyz"] for row in rows])
    ratios = [float(row["ratio"]) for row in rows]
    np.testing.assert_allclose(ratios, np.abs(directions[:, 0]), rtol=1e-9)
    # With w = L⊥² and L∥² = c, w′ = −(2κ/I₁³)(w + c)w, and E − E∞ = w/(2I₁).
    squares = directions[:, 0] ** 2
    long, across = 2 * 30**2, 300**2 + 30**2
    h = (1 - squares) + squares * across / long  # hI₁
    unit = 1600 * 27e-23 * across * 1e-18 / 12 / kappa(4000) / (2e9 * math.pi) ** 2
    expected = unit * h**2 * np.log1p(squares) / (2 * squares)
    times = [float(row["half_time"]) for row in rows]
    np.testing.assert_allclose(times, expected, rtol=1e-6)
    assert float(line(result.output, "half time, s")[2]) == pytest.approx(
        np.median(times), rel=1e-2
    )
    assert (tmp_path / "prediction.png").stat().st_size > 10_000


def test_a_tilted_dipole_stops_after_its_lifetime(tmp_path):
    """L² = L²ₚ/(1 + t/T) with T = J₃/(2κε²Ωₚ²), at the plateau of a dipole ε = 0.001 off axis 3."""
    solid = ["--box", "100x60x40nm", "--density", 2000, "--dipole", 2400]
    arguments = [*solid, "--momentum", "1,1,1", "--along"]
    results = [
        invoke("predict", *arguments, along, "--output", tmp_path / "t")
        for along in ("0,0,1", "0,0.001,1")
    ]
    aligned, tilted = (result.output for result in results)
    assert line(aligned, "outcome") == ["residual", "rotation"]
    assert line(tilted, "outcome") == ["stop"]
    moment = 2000 * 24e-23 * (100**2 + 60**2) * 1e-18 / 12
    kept = float(line(aligned, "L∞/L₀")[0])
    # L₀ = spin/h₀, h₀ = (p₁ + p₂ + p₃)/3 along (1, 1, 1).
    moments = 2000 * 24e-23 / 12 * 1e-18 * np.array([60**2 + 40**2, 100**2 + 40**2, 100**2 + 60**2])
    plateau = kept * 2e9 * math.pi / np.mean(1 / moments) / moment
    lifetime = moment / (2 * kappa(2400) * 1e-6 * plateau**2)
    assert float(line(tilted, "lifetime")[0]) == pytest.approx(lifetime, rel=3e-3)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ("", "One of --particle, --box, --rod, --sphere or --ellipsoid must be given, but none is"),
        ("--particle cds --rod 9x1nm", "but --particle and --rod are."),
        ("--sphere 9nm --density 1000 --dipole 9", "--sphere needs --along, too."),
        ("--particle cds --density 3", "--density is that of a solid; a --particle has its own."),
        ("--particle cds --axis x --momentum x", "--momentum and --axis cannot both be given."),
        ("--box 3x2nm", "'3x2nm' is not 3 positive lengths with a unit (nm, um, mm, …) such as"),
        ("--box 3x2x1", "'3x2x1' is not 3 positive lengths with a unit"),
        ("--sphere -3nm", "'-3nm' is not a positive length with a unit"),
        ("--particle cds --along 0,0,0", "'0,0,0' is not a direction such as x, y, z or 1,0,0.01."),
        ("--particle cds --spin 1kg", "Argument `spin` must be a number with a unit among Hz"),
        ("--particle cds --dipole 0", "Argument `dipole` must not be zero"),
        ("--particle cds --spin 1e8GHz --axis x", "must have a rim slower than 0.1 c, since"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(tmp_path, arguments, sentence):
    assert sentence in refusal("predict", *arguments.split(), "--output", f"{tmp_path}/p")
    assert list(tmp_path.iterdir()) == []


def test_solids_have_the_mass_of_their_size(monkeypatch, tmp_path):
    """The sizes are edges and diameters; nothing is predicted here."""
    from dipoletop.cli import predict_command

    seen = []
    monkeypatch.setattr(predict_command, "_predictions", lambda particle, *_: seen.append(particle))
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


def test_quantiles_and_durations():
    values = np.array([3.0, np.nan, 1.0, np.inf, 2.0])
    assert quantiles_of(values[[0, 2, 4]], np.ones(3)) == pytest.approx([1.0, 2.0, 3.0])
    assert quantiles_of(values, np.ones(5))[:2] == [1.0, pytest.approx(3.0)]
    assert math.isnan(quantiles_of(values, np.ones(5))[2])
    assert quantiles_of(values[2:4], np.array([8.0, 2.0])) == [1.0, 1.0, math.inf]
    texts = [duration(x) for x in (5.0, 7200.0, 3.15576e7, math.inf, math.nan)]
    assert texts == ["5 s", "7200 s, 2 hours", "3.156e+07 s, 1 years", "∞", "not known"]
    assert re.fullmatch(r"1e\+06 s, 11\.6 days", duration(1e6))
