"""Results of other threads, brought to a page on a server or in a notebook."""

import threading
from collections.abc import Callable
from typing import Any

import panel as pn


class Outlet:
    """Runs what changes a page where it may be run.

    On a server that is its event loop, at the next opportunity, so that no session waits for
    another one's work. In a notebook it is any thread, one at a time; changes of Bokeh's models
    are then sent by hand.
    """

    def __init__(self) -> None:
        document = pn.state.curdoc
        self._document = document if document and document.session_context else None
        self._changing = threading.RLock()
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
            return
        with self._changing:
            change()
            pn.io.push_notebook(*self.panes)
