"""How the pictures of the gallery are drawn: each from a fresh start, in few bytes."""

from typing import Any

import matplotlib.pyplot as plt
from matplotlib.figure import Figure
from PIL import Image
from sphinx_gallery.scrapers import figure_rst

WIDE = 2.0
"""Width over height of a picture with two panels side by side."""


def reset(gallery_conf: dict[str, Any], name: str) -> None:
    """Before each example: no figure is open, and a picture has few pixels."""
    plt.close("all")
    plt.rcdefaults()
    plt.rcParams.update({"figure.dpi": 90, "savefig.dpi": 90, "figure.max_open_warning": 5})


def figures(block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """The figures that an example leaves behind, those without a number of pyplot, too."""
    numbered = [plt.figure(number) for number in plt.get_fignums()]
    made = [x for x in block_vars["example_globals"].values() if isinstance(x, Figure)]
    paths = []
    for figure in dict.fromkeys([*numbered, *made]):
        path = next(block_vars["image_path_iterator"])
        figure.savefig(path)
        picture = Image.open(path).convert("RGB")
        if picture.width > WIDE * picture.height and not paths:
            # The thumbnail is the first file: here the left one of two panels.
            picture.crop((0, 0, picture.width // 2, picture.height)).save(path)
            path = next(block_vars["image_path_iterator"])
        picture.save(path, optimize=True)
        paths.append(path)
    plt.close("all")
    return figure_rst(paths, gallery_conf["src_dir"])
