"""The results of the benchmarks, which lie outside of the site's folder, as pages of the site."""

import shutil
from pathlib import Path
from typing import Any


def copy(app: Any) -> None:
    """Bring `benchmarks/results` up to date in `results/`."""
    source = Path(app.srcdir).parent / "benchmarks" / "results"
    target = Path(app.srcdir) / "results"
    target.mkdir(exist_ok=True)
    for old in target.iterdir():
        if not (source / old.name).exists():
            old.unlink()
    for path in source.iterdir():
        shutil.copy2(path, target / path.name)  # with its date: Sphinx reads what is newer


def setup(app: Any) -> dict[str, bool]:
    """Connect to the beginning of a build."""
    app.connect("builder-inited", copy)
    return {"parallel_read_safe": True}
