"""Where a command writes its picture and its data."""

import os
from pathlib import Path

import click

from .refusals import Refusal

FORMATS = click.Choice(["png", "pdf", "svg"])


def output_paths(output: str, suffix: str | None, name: str) -> tuple[Path, Path]:
    """The path that all files begin with, and that of the picture; `name` in a folder.

    `output` may end with the format of the picture; a missing folder is made.
    """
    check_output(output)
    base = Path(output)
    if output.endswith(("/", os.sep)) or base.is_dir():
        base = base / name
    if base.suffix[1:] in FORMATS.choices:
        suffix, base = suffix or base.suffix[1:], base.with_suffix("")
    make_folder(base.parent)
    return base, base.with_name(f"{base.name}.{suffix or 'png'}")


def check_output(output: str) -> None:
    """Refuse an output without a name."""
    if not output.strip():
        raise Refusal("--output must be a folder or the first part of a file name, but is empty.")


def make_folder(folder: Path) -> None:
    """Make a folder, and those above it, unless it is there."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = (error.strerror or type(error).__name__).lower()
        raise Refusal(f"--output: the folder {folder} cannot be made ({reason}).") from None
