"""Runs a command in this process, and reads what it prints and writes."""

import csv

from click.testing import CliRunner

from dipoletop.cli import main


def invoke(*arguments):
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def said(*arguments):
    """What a command prints that ends well."""
    result = invoke(*arguments)
    assert result.exit_code == 0, result.output
    return result.output


def refusal(*arguments):
    """The one line of a command that is refused."""
    result = invoke(*arguments)
    assert result.exit_code == 2, result.output
    assert "Traceback" not in result.output
    (line,) = [line for line in result.stderr.splitlines() if line.startswith("Error: ")]
    return line.removeprefix("Error: ")


def table(path):
    with path.open() as lines:
        return list(csv.DictReader(lines))
