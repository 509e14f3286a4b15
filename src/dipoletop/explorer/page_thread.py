"""Changes of a page, which run in the thread that it belongs to."""

import asyncio
import threading
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

    def __init__(self, panes: list[Any]) -> None:
        document: Any = pn.state.curdoc
        self.is_served = bool(document and document.session_context)
        """Whether the page is a session of a server."""
        self._loop, self._thread = asyncio.get_running_loop(), threading.get_ident()
        # Called in the loop's thread, too: of what another thread adds to a document, some is lost
        # while Panel changes it.
        self._run = document.add_next_tick_callback if self.is_served else self._changed
        self._panes = panes

    def post(self, change: Callable[[], None]) -> None:
        """Run a change of the page, asked for by any thread."""
        self._loop.call_soon_threadsafe(self._run, change)

    def run(self, change: Callable[[], None]) -> None:
        """Run a change in the thread of the page, and wait for its end."""
        if threading.get_ident() == self._thread:
            change()
            return

        async def changed() -> None:
            change()

        asyncio.run_coroutine_threadsafe(changed(), self._loop).result()

    def _changed(self, change: Callable[[], None]) -> None:
        change()
        pn.io.push_notebook(*self._panes)


class PageLayout(pn.Column):
    """A column that takes what a browser sends to a notebook in the thread of the page.

    JupyterLab delivers messages in another thread, and Panel takes what the page changes meanwhile
    for moves of the user. Panel also loses the events of a message that follow the first one to
    change the page; so it is given one event at a time.
    """

    outlet: Outlet

    def _on_msg(self, ref: str, manager: Any, msg: dict[str, Any]) -> None:
        def take() -> None:
            for event in msg["content"]["events"]:
                part = msg | {"content": msg["content"] | {"events": [event]}}
                super(PageLayout, self)._on_msg(ref, manager, part)

        self.outlet.run(take)
