"""`dipoletop validate` and `spectrum`, help, version, float64."""

import math
import re
import subprocess
import sys

import jax
import pytest
from command_line import invoke, refusal

import dipoletop as dt
from dipoletop import validation
from dipoletop.cli.quantities import OPTIONS


def test_the_command_switches_float64_on():
    code = (
        "from dipoletop import cli, validation; "
        "validation.CHECKS = (validation.float64,); cli.main()"
    )
    command = [sys.executable, "-c", code, "validate"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "double precision" in done.stdout


def _checks(*errors):
    def check():
        return [validation.Check(f"number {k}", 2.0, 2.0 + e, 2.0, 1e-3) for k, e in errors]

    return (check,)


def _broken():
    raise RuntimeError("no such device\nand more")


def test_validate_ends_with_0_if_all_is_well(monkeypatch):
    monkeypatch.setattr(validation, "CHECKS", _checks((1, 0.0), (2, 1e-3)))
    result = invoke("validate")
    assert result.exit_code == 0
    assert result.output.endswith("All passed.\n")
    assert f"jax {jax.__version__}" in result.output
    assert jax.devices()[0].platform in result.output
    assert re.search(r"number 2 +2 +2.001 +5.0e-04 +1.0e-03 ok", result.output)


@pytest.mark.parametrize("error", [3e-3, math.nan])
def test_validate_ends_with_1_if_a_check_fails(monkeypatch, error):
    monkeypatch.setattr(validation, "CHECKS", (*_checks((1, error)), _broken, *_checks((2, 0.0))))
    result = invoke("validate")
    assert result.exit_code == 1
    assert re.search(r"number 1 .* FAILED", result.output)
    assert re.search(r"no such device .* FAILED", result.output)
    assert re.search(r"number 2 .* ok", result.output)
    assert result.output.endswith("2 failed.\n")


@pytest.mark.parametrize("command", [[], ["map"], ["simulate"], ["spectrum"]])
def test_help_explains_every_word(command):
    result = invoke(*command, "--help")
    assert result.exit_code == 0
    for word in (*OPTIONS, "δ", "ω⊥", "ω₃", "φ", "τ₀", "order-1", "semi", "Certified"):
        assert word in result.output
    assert max(len(line) for line in result.output.splitlines()) <= 100


def test_an_error_of_the_program_keeps_its_traceback(monkeypatch):
    def broken():
        raise ValueError("operands could not be broadcast together")

    monkeypatch.setattr(validation, "environment", broken)
    result = invoke("validate")
    assert result.exit_code == 1
    assert isinstance(result.exception, ValueError)
    assert "Error: " not in result.output


def test_version_and_unknown_commands():
    assert dt.__version__ in invoke("--version").output
    assert "No such command 'maps'" in refusal("maps")


def test_spectrum_prints_the_eigenvalues():
    """Order 1: 0, −w², −(1+2δ)/(1−δ) w²; at δ = −0.6 the last is positive."""
    result = invoke("spectrum", "--delta", -0.6, "--w", 0.1, "--level", "order-1")
    assert result.exit_code == 0
    first, slow, back, consistent = result.output.splitlines()
    assert consistent.startswith("Order 1 lacks a leading term of the full equation; semi-reduced")
    assert "semi-reduced: stable" in consistent
    assert first.endswith("not stable")
    assert [float(x) for x in slow.split()[1:]] == pytest.approx([0, 0.00125, -0.01], rel=1e-9)
    assert back.strip().startswith("return time inf")
    assert "`delta` must lie in [-1, 1), but is 1" in refusal("spectrum", "--delta", 1)
