"""The function `explore`, and its result, an `Explorer`."""

import asyncio
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from typing import Any

from .._maps.basin import Basin
from ..equations.levels import Level
from . import recipes
from .drawing import Drawing
from .scenes import Over, Scene, scene_of
from .views import View, address_of, first_view, view_at
from .workshop import Workshop

NEEDED = "panel", "bokeh"
MISSING = "The explorer needs Panel: pip install 'dipoletop[explore]'."

IN_NOTEBOOK = "In a notebook the explorer is shown as output of a cell; `serve` is for scripts."


class Explorer:
    """A page to explore: shown as output in a notebook, or at an address by `serve`.

    Every notebook output and every session of a server has its own state.

    Attributes:
        is_working: property; whether a picture or a start is being computed.
        view: property; the view of the page that was opened last.
        basins: property; the basins of the last finished picture, one for each level; () at first.
    """

    def __init__(self, scene: Scene, view: View) -> None:
        self._workshop, self._first = Workshop(scene, Drawing(scene)), view
        self._page: Any = None

    @property
    def view(self) -> View:
        """The view of the page that was opened last."""
        return self._first if self._page is None else self._page.view

    @property
    def basins(self) -> tuple[Basin, ...]:
        """The basins of the last finished picture, before `plots.unfold`; () at first."""
        picture = self._workshop.picture
        return () if picture is None else picture.basins

    @property
    def is_working(self) -> bool:
        """Whether a picture or a start is being computed."""
        return self._workshop.turns.is_working or self._workshop.starts.is_working

    def code(self) -> str:
        """Return a script that computes and draws `view`."""
        return recipes.code_of(self._workshop.scene, self.view)

    def address(self) -> str:
        """Return the query of an address that opens a page at `view`."""
        return address_of(self.view)

    def serve(
        self,
        address: str = "127.0.0.1",
        port: int = 0,
        *,
        origins: Sequence[str] = (),
        show: bool = True,
        say: Callable[[str], None] = print,
    ) -> None:
        """Serve the page until Ctrl-C, with a state of its own for everyone who opens it.

        Args:
            address: the address to listen at; any but loopback lets other machines in, without a
                password.
            port: the port to listen at; 0 means any free one.
            origins: further hosts, such as "example.org:8080", whose pages may open a session, for
                example if the server stands behind a proxy. Pages of all others are refused.
            show: whether to open a browser.
            say: called with the address of the page.

        Raises:
            ValueError: bad arguments.
            RuntimeError: the program has an event loop already, as a notebook has.
            OSError: the address or the port cannot be used.
        """
        from .server import made_server, serve

        if _in_event_loop():
            raise RuntimeError(IN_NOTEBOOK)
        server = made_server(self._session, address=address, port=port, origins=origins)
        serve(server, address, show=show, say=say)

    def _session(self, query: dict[str, list[str]]) -> Any:
        """Return the page for the query of an address, or a page with the reason of refusal."""
        from .page import refusal_page

        try:
            view = view_at(self._workshop.scene, self._first, query)
        except ValueError as error:
            return refusal_page(str(error))
        return self._opened(view)

    def _opened(self, view: View) -> Any:
        from .page import Page

        self._page = Page(self._workshop, view)
        return self._page.layout

    def _repr_mimebundle_(self, include: Any = None, exclude: Any = None) -> Any:
        """Return a new page as output of a notebook; text if there is no browser."""
        import panel as pn

        if not _in_event_loop():
            return {"text/plain": repr(self)}
        if not pn.extension._loaded:
            pn.extension(inline=True)  # so that it needs no other server
        return self._opened(self.view)._repr_mimebundle_(include, exclude)

    def __repr__(self) -> str:
        view = self.view
        levels = ", ".join(level.label for level in view.levels) or "a given equation"
        return f"Explorer({levels}: {view.x}, {view.y}; `.serve()` opens it in a browser)"


def _in_event_loop() -> bool:
    try:
        asyncio.get_running_loop()
    except RuntimeError:
        return False
    return True


def explore(
    problem: Any = None,
    over: Over | None = None,
    *,
    level: str | Level | Sequence[str | Level] = (),
    x: str | None = None,
    y: str | None = None,
    size: int = 256,
    rtol: float = 1e-8,
) -> Explorer:
    """Make a page with the basin map of dω/dτ = equation(ω), and sliders for its parameters.

    The map is over two of the quantities; each of the others has a slider.

    In a notebook the result is shown as output; elsewhere its method `serve` opens a page in a
    browser, as `dipoletop explore` does. The picture follows a slider, coarse at first. A click on
    a start shows its verdict, its motion, and the derivatives of ω∞ there. The page also writes the
    code of its picture.

    | `problem` | the explored problem | quantities |
    |---|---|---|
    | None | the transverse top at any level | delta, phi, and w_perp, w3 or amplitude, theta |
    | `TransverseReduced`, `TransverseSemi` | this top, at this level and δ | as for None |
    | another equation | its starts | phi, and w_perp, w3 or amplitude, theta |
    | a function as for `sweep` | the problem that it defines | its arguments |

    Args:
        problem: see the table. A function must be pure JAX, and its arguments numbers.
        over: for each quantity a number, its first value, or a pair (low, high), its range. If
            `problem` is a function, every argument needs one of them, and an argument with a
            number stays fixed. ω is in units of 1/τ₀, angles are in radians.
        level: one level of the equation, or two to compare, such as ("order-1", "semi"); by default
            the level of `problem`, or semi-reduced.
        x: the horizontal axis; None means φ if there is one.
        y: the vertical axis; None means ω₃ or ϑ if there is one.
        size: starts on each axis: 64, 128, 256, 512 or 1024.
        rtol: relative tolerance of every step.

    Returns:
        An `Explorer`.

    Raises:
        ImportError: Panel is not installed (`pip install 'dipoletop[explore]'`).
        ValueError: bad arguments.

    Example:
        >>> import dipoletop as dt
        >>> explorer = dt.explore(dt.TransverseSemi(-0.3), {"w_perp": 0.1}, y="delta")
        >>> explorer
        Explorer(semi-reduced: phi, delta; `.serve()` opens it in a browser)
        >>> print(explorer.code().splitlines()[-1])
        dt.plots.save(dt.plots.basin(basin, x="phi", y="delta", unfold=True), "map.png")
    """
    if any(find_spec(name) is None for name in NEEDED):
        raise ImportError(MISSING)
    scene = scene_of(problem, over)
    levels = (level,) if isinstance(level, str) else tuple(level)
    return Explorer(scene, first_view(scene, x, y, levels or scene.at_first, rtol=rtol, size=size))
