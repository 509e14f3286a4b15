"""The ledger of the paper: lines that hold, and that would not if either form were another."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from click.testing import CliRunner

import dipoletop as dt
from dipoletop import cli, paper
from dipoletop.paper import (
    Entry,
    ledger_averaged,
    ledger_claims,
    ledger_equation_of_motion,
    ledger_longitudinal,
    ledger_rotator,
    ledger_transverse,
)
from dipoletop.particles import particle

MOST_PROGRAMS = 250  # the ledger is read line by line, and computed operation by operation

# Where each part corrects the paper, and two parts of parts; first those that compile little.
PLAIN = {
    ledger_averaged.orbits: ["(4.17)", "(4.17)", "(4.19)"],
    ledger_claims.conclusions: ["conclusions", "conclusions"],
    ledger_longitudinal.braking_time: [],
    ledger_rotator.phase_plane: ["(A.11)"],
    ledger_longitudinal.changed_variables: [],
    ledger_longitudinal.blow_up: ["(B.13)"],
}
SLOW = {
    ledger_equation_of_motion.rotator: [],
    ledger_equation_of_motion.motion: ["(3.2)"],
    ledger_longitudinal.equations: [],
    ledger_transverse.equations: ["(4.6)", "after (4.6)", "after (4.12)"],
    ledger_averaged.late: ["(4.20)", "(4.20)", "(4.20)", "(4.21)"],
    ledger_rotator.manifold: ["end of appendix A"],
    ledger_rotator.asymptotics: ["(A.3)–(A.4)"],
    ledger_averaged.limits: [],
    ledger_transverse.fixed_points: [
        "before (4.22)",
        "section 4.1",
        "section 4.2, 1",
        "section 4.2",
        "(4.4)",
    ],
    ledger_claims.outcomes: 3 * ["section 4.2, 1"] + ["section 4.2, 2"],
    ledger_claims.figures: ["figure 2a"],
    ledger_claims.exceptions: 3 * ["section 4.2, 1"],
    ledger_claims.asymmetric: ["closing statement"],
    ledger_longitudinal.asymptotics: ["(B.5)", "(B.9)", "(B.13)"],
}
CORRECTED = PLAIN | SLOW
PARTS = [*PLAIN, *(pytest.param(part, marks=pytest.mark.slow) for part in SLOW)]


@pytest.mark.parametrize("part", PARTS, ids=lambda part: part.__name__)
def test_lines_hold(part):
    lines = list(part())
    assert lines
    assert [line for line in lines if not line.holds] == []
    corrected = [line for line in lines if line.verdict == "corrected"]
    assert [line.place for line in corrected] == CORRECTED[part]
    assert all(line.printed_residual > 10 * line.limit for line in corrected)


def test_no_part_is_left_out():
    assert set(paper.PARTS) < set(CORRECTED)


def test_a_verdict_needs_a_form_that_holds_and_a_printed_one_that_does_not():
    confirmed = Entry("(1)", "x", 1e-15, 1e-14)
    assert confirmed.verdict == "confirmed"
    assert confirmed._replace(residual=1e-13).verdict == "FAILED"
    assert confirmed._replace(residual=np.nan).verdict == "FAILED"
    corrected = confirmed._replace(printed="y", printed_residual=0.3)
    assert corrected.verdict == "corrected"
    assert corrected._replace(residual=1e-13).verdict == "FAILED"
    assert corrected._replace(printed_residual=1e-16).verdict == "FAILED"  # the paper is right
    assert corrected._replace(printed_residual=np.nan).verdict == "FAILED"
    assert confirmed._replace(printed="y").verdict == "FAILED"  # not tried


def scaled(function, factor):
    """The function with its numbers multiplied."""

    def larger(*args, **options):
        return jax.tree.map(lambda x: x * factor, function(*args, **options))

    return larger


def heavier(delta):
    """The full equation of a top whose ζ is smaller by 0.05."""
    return dt.LongitudinalFull(delta + 0.05)


ROTATOR = scaled(dt.exact.rotator, 1 + 1e-9)
TORQUE = scaled(dt.radiation.radiation_torque, 1 + 1e-9)
LATE = scaled(dt.exact.averaged_late, 12.2 / 12)
RIGHT, PRINTED = ledger_averaged.p_right, ledger_averaged.p_printed
Q = scaled(ledger_averaged.q_printed, 1.001)
CHANGED, BLOW_UP = ledger_longitudinal.changed_variables, ledger_longitudinal.blow_up
PLANTS = [
    (ledger_equation_of_motion.rotator, dt.exact, "rotator", ROTATOR, "(2.4)"),
    (ledger_equation_of_motion.motion, dt.radiation, "radiation_torque", TORQUE, "(3.2)"),
    # The p that the paper prints in place of the right one, and the reverse.
    (ledger_averaged.orbits, ledger_averaged, "p_right", PRINTED, "(4.16)"),
    (ledger_averaged.orbits, ledger_averaged, "p_right", PRINTED, "(4.17)"),
    (ledger_averaged.orbits, ledger_averaged, "p_right", PRINTED, "(4.19)"),
    (ledger_averaged.orbits, ledger_averaged, "p_printed", RIGHT, "(4.19)"),
    (ledger_averaged.orbits, ledger_averaged, "q_printed", Q, "(4.18)"),
    (ledger_averaged.late, dt.exact, "averaged_late", LATE, "(4.20)"),
    (ledger_claims.conclusions, particle, "RADIATION", 2.4e-16, "conclusions"),
    (ledger_claims.conclusions, ledger_claims, "FASTER", 0.5, "conclusions"),
    (ledger_rotator.phase_plane, ledger_rotator, "separatrix", dt.critical_manifold, "(A.11)"),
    (ledger_rotator.phase_plane, ledger_rotator, "ROOT", 1.42, "(A.7)–(A.12)"),
    (CHANGED, ledger_longitudinal, "LongitudinalFull", heavier, "(B.6)–(B.8)"),
    (BLOW_UP, ledger_longitudinal, "LongitudinalFull", heavier, "(B.13)"),
]


@pytest.mark.parametrize(
    ("part", "module", "name", "wrong", "place"),
    [
        pytest.param(*plant, marks=pytest.mark.slow)
        if plant[0] in (ledger_equation_of_motion.motion, ledger_averaged.late)
        else plant
        for plant in PLANTS
    ],
    ids=[f"{name}-{place}" for _, _, name, _, place in PLANTS],
)
def test_a_wrong_form_is_found(part, module, name, wrong, place, monkeypatch):
    monkeypatch.setattr(module, name, wrong)
    assert place in [line.place for line in part() if not line.holds]


def test_the_logarithm_of_the_stop_is_measured(monkeypatch):
    monkeypatch.setattr(ledger_rotator, "LOGARITHM", 0.7)
    assert not next(ledger_rotator.asymptotics()).holds


def test_a_linearisation_of_the_right_equations_is_needed():
    line = ledger_transverse.linearised()
    assert (line.place, line.verdict) == ("before (4.22)", "corrected")


def test_other_fixed_points_are_found(monkeypatch):
    """Without braking of ω₂ every ω with ω₃ = 0 is fixed."""
    flat = jnp.array([1.0, 1.0, 0.0])

    def unbraked(delta):
        first = dt.TransverseReduced(delta)
        return lambda t, y: first(t, y) - jnp.stack([0 * y[0], first(t, y * flat)[1], 0 * y[0]])

    monkeypatch.setattr(ledger_transverse, "TransverseReduced", unbraked)
    assert ledger_transverse.elsewhere() > 0.5


def test_the_command_prints_both_forms(monkeypatch):
    def breaks():
        raise ValueError("no such thing")

    def corrects():
        yield Entry("(1)", "right", 1e-15, 1e-14, "wrong", 0.25)

    monkeypatch.setattr(paper, "PARTS", (ledger_equation_of_motion.rotator, corrects, breaks))
    result = CliRunner().invoke(cli.main, ["validate", "--paper"])
    assert result.exit_code == 1
    lines = result.output.splitlines()
    assert any(line.startswith("confirmed  (2.4)") for line in lines)
    at = lines.index("corrected  (1): right; residual 1.0e-15, allowed 1.0e-14")
    assert lines[at + 1].split() == ["the", "paper", "has", "wrong;", "residual", "2.5e-01"]
    assert lines[at + 2].startswith("FAILED     breaks")
    assert "no such thing" in lines[at + 2]
    assert result.output.endswith("1 failed.\n")
