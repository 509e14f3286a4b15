"""The results of the benchmarks, which lie outside of the site's folder, as pages of the site."""

import re
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
        if path.suffix == ".md":
            text = path.read_text(encoding="utf-8")
            measured = re.sub(r"\[(\w+\.json)\]\(\1\)", lambda m: _link(source, m), text)
            if measured != text:
                (target / path.name).write_text(measured, encoding="utf-8")


def _link(source: Path, match: re.Match[str]) -> str:
    """The link to numbers; their name alone where nothing is measured yet."""
    return match[0] if (source / match[1]).exists() else match[1]


def setup(app: Any) -> dict[str, bool]:
    """Connect to the beginning of a build."""
    app.connect("builder-inited", copy)
    return {"parallel_read_safe": True}
