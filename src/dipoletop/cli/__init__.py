"""The command line: `dipoletop map`, `simulate`, `predict`, `atlas`, `figures`, …."""

from collections.abc import Iterator, Mapping
from importlib import import_module

import click

from .options import TERMS

COMMANDS = {
    "atlas": ("particle_commands", "How bodies of every shape end."),
    "balance": ("particle_commands", "Which torque brakes a real particle."),
    "explore": ("commands", "Maps in the browser that follow sliders."),
    "export": ("store_commands", "Data of a store as NetCDF, Parquet or CSV."),
    "figures": ("commands", "The figures of the paper, and three more."),
    "info": ("store_commands", "What is in a store, and how far its sweep is."),
    "map": ("map_command", "Which starts keep rotating and which stop."),
    "plot": ("store_commands", "A picture of the data in a store."),
    "predict": ("particle_commands", "How the rotation of a real particle ends."),
    "simulate": ("commands", "One top: its motion and its outcome."),
    "spectrum": ("commands", "How perturbations of a residual rotation decay."),
    "store": ("store_commands", "Verify and repair the data of a sweep."),
    "validate": ("commands", "Check this installation against exact values."),
}
"""Each command: the module that has it as `NAME_command`, and a line of help."""
SHOWN = {"show_default": True, "help_option_names": ["-h", "--help"], "max_content_width": 100}


class OnDemand(Mapping[str, click.Command]):
    """The commands by name, imported when they are asked for.

    What a command computes with is imported inside it: help, a misspelt word and the completion of
    a shell need neither JAX nor a compilation.
    """

    def __getitem__(self, name: str) -> click.Command:
        module, line = COMMANDS[name]
        command = getattr(import_module(f".{module}", __name__), f"{name}_command")
        command.short_help = line
        return command

    def __iter__(self) -> Iterator[str]:
        return iter(COMMANDS)

    def __len__(self) -> int:
        return len(COMMANDS)


@click.group(commands=OnDemand(), epilog=TERMS, context_settings=SHOWN)  # pyright: ignore
@click.version_option(package_name="dipoletop", message="%(prog)s %(version)s")
def main() -> None:
    """Rotation of a rigid electric dipole that radiates: does it keep rotating, or stop?"""


__all__ = ["main"]
