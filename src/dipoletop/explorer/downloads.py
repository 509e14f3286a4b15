"""What a page gives to take away: its picture as `plots` draws it, and the data of its starts."""

import io

from matplotlib.figure import Figure

from .. import plots
from .pictures import Picture

FORMATS = "png", "pdf", "csv"


def file_of(picture: Picture, folded: bool, suffix: str) -> io.BytesIO:
    """Return a picture as a file of one of `FORMATS`.

    Args:
        picture: the picture, with its basins.
        folded: whether symmetries give all starts from those of the basins.
        suffix: the format.
    """
    file = io.BytesIO()
    if suffix == "csv":
        for number, basin in enumerate(picture.basins):
            table = basin.to_dataframe().assign(level=basin.level)
            table.to_csv(file, index=False, header=number == 0, float_format="%.17g")
    else:
        _drawn(picture, folded).savefig(file, format=suffix, dpi=150)
    file.seek(0)
    return file


def _drawn(picture: Picture, folded: bool) -> Figure:
    """Return the figure of `plots` for the starts of a picture."""
    x, y, basins = picture.view.x, picture.view.y, picture.basins
    figure = Figure((12.0, 5.6) if len(basins) == 2 else (7.0, 4.6), layout="constrained")
    if len(basins) == 2:
        axes = list(figure.subplots(1, 2, sharey=True))
        return plots.compare(*basins, axes=axes, x=x, y=y, unfold=folded)
    plots.basin(basins[0], ax=figure.subplots(), x=x, y=y, unfold=folded)
    return figure
