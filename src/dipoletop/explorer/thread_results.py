"""Results of other threads, brought to a page on a server or in a notebook."""

import asyncio
from collections.abc import Callable
from typing import Any

import panel as pn


class Outlet:
    """A queue of changes of a page, which run in the thread that the page belongs to.

    On a server this is its event loop: changes run at the next opportunity, and no session waits
    for another one's work. In a notebook it is the loop of the kernel: changes run between the
    cells, since the messages of two threads would mix. There, changes of Bokeh's models must be
    sent explicitly.
    """

    def __init__(self) -> None:
        document = pn.state.curdoc
        self._document = document if document and document.session_context else None
        self._loop: asyncio.AbstractEventLoop | None = None
        if self._document is None:
            self._loop = asyncio.get_running_loop()
        self.panes: list[Any] = []
        """The panes of Bokeh's figures."""

    @property
    def is_served(self) -> bool:
        """Whether the page is a session of a server."""
        return self._document is not None

    def post(self, change: Callable[[], None]) -> None:
        """Run a change of the page."""
        if self._document is not None:
            self._document.add_next_tick_callback(change)
        elif self._loop is not None:
            self._loop.call_soon_threadsafe(self._changed, change)

    def _changed(self, change: Callable[[], None]) -> None:
        change()
        pn.io.push_notebook(*self.panes)
