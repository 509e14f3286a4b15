"""The server of an explorer, on loopback by default."""

import contextlib
import signal
import socket
import webbrowser
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import panel as pn
from bokeh.server.util import create_hosts_allowlist
from bokeh.themes import DARK_MINIMAL
from panel.io.server import get_server

from .._base.checks import instance, names_of
from .._base.refusals import refuse
from .._base.tolerances import whole
from .texts import DARK, THEME

LOOPBACK = "127.0.0.1"
TITLE = "dipoletop explore"
SIGNALS = signal.SIGINT, signal.SIGTERM
HEAD = Path(__file__).with_name("head.html").read_text(encoding="utf-8")
"""For the page: its width on a phone, the view of an address to which the user goes back, and the
colours of a dark page."""
STOPPED = "The server has stopped: this page no longer follows what you do."
BLOCKED = {1719, 1720, 1723, 2049, 3659, 4045, 4190, 5060, 5061, 6000, 6566, 6679, 6697, 10080}
BLOCKED |= set(range(6665, 6670))
"""Ports above 1023 that browsers refuse to open (the "bad ports" of the Fetch standard)."""


def serve(server: Any, address: str, *, show: bool, say: Callable[[str], None]) -> None:
    """Run a server until a signal ends it.

    Args:
        server: the server, from `made_server`.
        address: the address it listens at.
        show: whether to open a browser.
        say: called with the address of the page.
    """
    url = f"http://{_host(address)}:{server.port}/"
    say(url)
    loop, before = server.io_loop, {number: signal.getsignal(number) for number in SIGNALS}
    try:
        for number in SIGNALS:
            signal.signal(number, lambda *_: loop.add_callback_from_signal(loop.stop))
        if show:
            loop.add_callback(webbrowser.open, url)
        server.start()
        loop.start()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        with contextlib.suppress(AssertionError):  # if it has already stopped
            server.stop()


def made_server(
    session: Callable[[dict[str, list[str]]], Any],
    *,
    address: str,
    port: int,
    origins: Sequence[str],
) -> Any:
    """Return a server that makes a page for every session, not started yet.

    Args:
        session: function from the query of an address to the page of a new session.
        address: the address to listen at.
        port: the port to listen at; 0 means any free one.
        origins: further hosts, with or without ":port", whose pages may open a session.

    Raises:
        ValueError: bad arguments.
        OSError: the address or the port cannot be used.
    """
    instance("address", address, str, "be a host name or an IPv4 address")
    if not address or ":" in address:
        refuse("address", "be a host name or an IPv4 address", f"is {address!r}")
    port = whole("port", port, 0, "be a whole number from 0 to 65535", 65535)
    if port in BLOCKED:
        refuse("port", "be one that browsers open", f"is {port}, which they block")
    port = port or _free_port(address)
    allowed = [f"{host}:{port}" for host in dict.fromkeys((_host(address), LOOPBACK, "localhost"))]
    for origin in names_of("origins", origins):
        allowed.append(_origin(origin))

    def page() -> Any:
        document: Any = pn.state.curdoc
        config: Any = pn.config
        given: dict[str, list[bytes]] = pn.state.session_args or {}
        query = {name: [x.decode("utf-8", "replace") for x in given[name]] for name in given}
        is_dark = query.pop(THEME, []) == [DARK]
        config.theme = DARK if is_dark else "default"
        if is_dark:
            document.theme = DARK_MINIMAL
        document.template = HEAD
        document.template_variables["is_dark"] = is_dark
        config.notifications = True
        config.disconnect_notification = STOPPED
        return session(query)

    return get_server(
        page, port=port, address=address, websocket_origin=allowed, title=TITLE, show=False
    )


def _origin(origin: str) -> str:
    """Return an origin in Bokeh's form; refuse patterns, which may admit unforeseen hosts."""
    must = "be hosts such as example.org or example.org:8080"
    if "*" in origin or "/" in origin:
        refuse("origins", must, f"one is {origin!r}")
    try:
        return create_hosts_allowlist([origin], None)[0]
    except ValueError:
        return refuse("origins", must, f"one is {origin!r}")


def _host(address: str) -> str:
    """Return the name by which a browser on this machine reaches an address."""
    return "localhost" if address == "0.0.0.0" else address


def _free_port(address: str) -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.bind((address, 0))
        return probe.getsockname()[1]
