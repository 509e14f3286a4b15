"""Where a command writes its picture and its data."""

import os
from pathlib import Path

import click

FORMATS = click.Choice(["png", "pdf", "svg"])


def output_paths(output: str, suffix: str | None, name: str) -> tuple[Path, Path]:
    """The path that all files begin with, and that of the picture; `name` in a folder.

    `output` may end with the format of the picture; a missing folder is made.
    """
    base = Path(output)
    if output.endswith(("/", os.sep)) or base.is_dir():
        base = base / name
    if base.suffix[1:] in FORMATS.choices:
        suffix, base = suffix or base.suffix[1:], base.with_suffix("")
    base.parent.mkdir(parents=True, exist_ok=True)
    return base, base.with_name(f"{base.name}.{suffix or 'png'}")
