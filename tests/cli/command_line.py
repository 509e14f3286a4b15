"""Runs a command in this process, and reads what it prints."""

import re

from click.testing import CliRunner

from dipoletop.cli import main


def invoke(*arguments):
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def refusal(*arguments):
    """The one line of a command that is refused."""
    result = invoke(*arguments)
    assert result.exit_code == 2
    assert "Traceback" not in result.output
    (line,) = [line for line in result.stderr.splitlines() if line.startswith("Error: ")]
    return line.removeprefix("Error: ")


def row(text, name):
    (line,) = [line for line in text.splitlines() if line.startswith(f"{name}  ")]
    return re.split(r"  +", line)[1:]
