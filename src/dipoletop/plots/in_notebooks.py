"""How notebooks show results: their text, and a small picture where there is one."""

import base64
import html
import io
import math
from typing import Any

from matplotlib import pyplot as plt

from .._maps.basin import Basin
from .._runs.trajectory import Trajectory
from ..atlases import Atlas
from ..prediction import Prediction
from ..surroundings import Balance
from .atlases import atlas
from .balances import balance
from .basins import basin
from .histories import history
from .single_starts import line, starts
from .trajectories import trajectory

MOST = 2**20  # starts of a basin that is drawn without being asked for
DPI = 60
DRAWN = {Trajectory: trajectory, Prediction: history, Atlas: atlas, Balance: balance}
"""The pictures of results other than basins."""


def html_of(result: Any) -> str:
    """Return the text of a result, and its picture, as HTML."""
    text = f"<pre>{html.escape(repr(result))}</pre>"
    try:
        drawn = _drawn(result)
    except ValueError:  # such as a balance at one pressure and one spin
        return text
    if drawn is None:
        return text
    figure = drawn if hasattr(drawn, "savefig") else drawn.figure
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=DPI)
    plt.close(figure)  # or it would be shown once more
    data = base64.b64encode(file.getvalue()).decode()
    return f'{text}<img alt="The same as a picture" src="data:image/png;base64,{data}">'


def _drawn(result: Any) -> Any:
    """Return a figure or its axes; None for a result that is too large to be drawn unasked."""
    if not isinstance(result, Basin):
        return next(draw(result) for kind, draw in DRAWN.items() if isinstance(result, kind))
    if math.prod(result.shape) > MOST:
        return None
    if not result.coords:
        return starts(result)
    if sum(n > 1 for n in result.shape) == 1:
        return line(result)
    return basin(result)
