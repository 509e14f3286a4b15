"""The ledger of the paper: lines that hold, and that would not if the physics were wrong."""

import numpy as np
import pytest
from click.testing import CliRunner

import dipoletop as dt
from dipoletop import cli, paper
from dipoletop.paper import Entry, _general, _longitudinal, _transverse

QUICK = [
    _general.rotator,
    _general.motion,
    _longitudinal.equations,
    _transverse.full_equation,
    _transverse.monotony,
]


@pytest.mark.parametrize("part", QUICK)
def test_lines_hold(part):
    lines = list(part())
    assert lines
    assert [line.verdict for line in lines if not line.holds] == []


def test_a_verdict_needs_a_residual_and_a_paper_that_fails():
    confirmed = Entry("(1)", "x", 1e-15, 1e-14)
    assert confirmed.verdict == "confirmed"
    assert confirmed._replace(residual=1e-13).verdict == "FAILED"
    assert confirmed._replace(residual=np.nan).verdict == "FAILED"
    corrected = confirmed._replace(correction="y", paper=0.3)
    assert corrected.verdict == "corrected"
    assert corrected._replace(paper=1e-16).verdict == "FAILED"  # then the paper is right


def test_wrong_physics_is_noticed(monkeypatch):
    rotator = dt.exact.rotator
    monkeypatch.setattr(dt.exact, "rotator", lambda w, tau: rotator(w * (1 + 1e-9), tau))
    assert [line.place for line in _general.rotator() if not line.holds] == ["(2.4)"]
    power = dt.radiation.radiation_torque
    monkeypatch.setattr(dt.radiation, "radiation_torque", lambda *a: power(*a) * (1 + 1e-9))
    assert "(3.2)" in [line.place for line in _general.motion() if not line.holds]


def test_the_command_prints_the_table(monkeypatch):
    def breaks():
        raise ValueError("no such thing")

    monkeypatch.setattr(paper, "PARTS", (_general.rotator, breaks))
    result = CliRunner().invoke(cli.main, ["validate", "--paper"])
    assert result.exit_code == 1
    assert "confirmed (2.4)" in result.output
    assert "FAILED    breaks" in result.output
    assert "no such thing" in result.output
    assert result.output.endswith("1 failed.\n")
