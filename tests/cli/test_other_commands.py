"""`dipoletop validate` and `spectrum`, help, version, float64."""

import math
import re
import subprocess
import sys

import jax
import pytest

import dipoletop as dt
from command_line import invoke, refusal, said
from dipoletop import validation


def test_the_command_switches_float64_on():
    code = (
        "from dipoletop import cli, validation; "
        "validation.CHECKS = (validation.float64,); cli.main()"
    )
    command = [sys.executable, "-c", code, "validate"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "double precision" in done.stdout


def test_help_and_misspelt_words_need_no_jax():
    code = """
import sys
import click
from dipoletop.cli import main
calls = [["mapp"], ["map", "--sise", "3"], ["map", "--size", "1"], ["--help"]]
calls += [[name, "--help"] for name in main.commands]
for arguments in calls:
    try:
        main(arguments, standalone_mode=False)
    except click.UsageError as error:
        print(error.format_message())
assert not {"jax", "numpy", "matplotlib"} & {*sys.modules}
"""
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "Did you mean 'map'?" in done.stdout


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
    assert "number 2: 2.001, expected 2; error 5.0e-04, allowed 1.0e-03" in result.output


@pytest.mark.parametrize("error", [3e-3, math.nan])
def test_validate_ends_with_1_if_a_check_fails(monkeypatch, error):
    monkeypatch.setattr(validation, "CHECKS", (*_checks((1, error)), _broken, *_checks((2, 0.0))))
    result = invoke("validate")
    assert result.exit_code == 1
    assert re.search(r"FAILED .*number 1:", result.output)
    assert re.search(r"FAILED .*no such device:", result.output)
    assert re.search(r"ok .*number 2:", result.output)
    assert result.output.endswith("2 failed.\n")


@pytest.mark.parametrize("command", [[], ["map"], ["simulate"], ["spectrum"]])
def test_help_explains_every_word(command):
    result = invoke(*command, "--help")
    assert result.exit_code == 0
    words = "delta", "w-perp", "w3", "phi", "amplitude", "theta", "order-1", "semi", "certified"
    for word in (*words, "δ", "ω⊥", "ω₃", "φ", "τ₀"):
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
    text = said("spectrum", "--delta", -0.6, "--w", 0.1, "--level", "order-1")
    first, consistent = re.findall(r"\(the paper's\)\n(.*?)semi-reduced\n(.*)", text, re.DOTALL)[0]
    assert "not stable" in first
    slow = re.search(r"slow: (.*)", first)[1].split(", ")
    assert [float(x) for x in slow] == pytest.approx([0, 0.00125, -0.01], rel=1e-9)
    assert "return_time=inf" in first
    assert "Spectrum(stable" in consistent
    assert consistent.endswith("Order 1 lacks a leading term of the full equation.\n")
    assert "--delta must lie in [-1, 1), but is 1" in refusal("spectrum", "--delta", 1)
