"""`dt.explore`: what it takes, what it refuses, and what it needs."""

import asyncio
import sys
import threading
from types import SimpleNamespace

import jax
import panel
import pytest

import dipoletop as dt
from command_line import refusal
from dipoletop.explorer import page_thread, server


def test_a_port_that_browsers_block_is_refused():
    with pytest.raises(ValueError, match="`port` must be one that browsers open, but is 6000"):
        dt.explore().serve(port=6000, show=False)


def test_panel_has_the_delay_that_sliders_switch_off():
    """It is private; without it, each move of a slider would wait for 50 ms again."""
    assert isinstance(panel.widgets.FloatSlider._debounce, int)


def test_it_has_a_view_and_code_without_any_page():
    explorer = dt.explore(dt.TransverseReduced(0.3), {"w_perp": 0.1}, size=64)
    assert explorer.view.levels == (dt.Level.ORDER_1,)
    assert explorer.view.fixed == {"delta": 0.3, "w_perp": 0.1}
    assert explorer.basins == ()
    assert "dt.sweep" in explorer.code()
    assert "level=order-1" in explorer.address()
    assert "Explorer(reduced, order 1 (the paper's): phi, w3" in repr(explorer)
    assert explorer._repr_mimebundle_() == {"text/plain": repr(explorer)}


@pytest.mark.parametrize("level", ["order-2", dt.Level.ORDER_2, ["order-2"]])
def test_levels_are_given_by_name_or_member(level):
    assert dt.explore(level=level).view.levels == (dt.Level.ORDER_2,)
    assert len(dt.explore(level=("order-1", "semi")).view.levels) == 2


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"level": "best"}, "Argument `level` must be one of order-1.*'best'"),
        ({"x": "gamma"}, "Argument `x` must be one of delta"),
        ({"x": "w3", "y": "theta"}, "Argument `start` must be given by"),
        ({"size": 100}, "Argument `size` must be one of 64"),
        ({"rtol": 2.0}, "Argument `rtol` must lie between"),
    ],
)
def test_bad_arguments_are_refused(arguments, sentence):
    with pytest.raises(ValueError, match=sentence):
        dt.explore(**arguments)


def test_float32_is_refused_with_the_switch():
    jax.config.update("jax_enable_x64", False)
    try:
        with pytest.raises(ValueError, match="jax_enable_x64"):
            dt.explore()
    finally:
        jax.config.update("jax_enable_x64", True)


def test_without_panel_a_sentence_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "panel", None)
    with pytest.raises(ImportError, match=r"needs Panel: pip install 'dipoletop\[explore\]'\."):
        dt.explore()
    assert refusal("explore", "--no-show").endswith("pip install 'dipoletop[explore]'.")


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ("--delta 3", "--delta must lie in [-1, 1), but is 3."),
        ("--w3 0.1 --theta 0.2", "start must be given by"),
        ("--range delta 0.5 0.1", "--delta must have a range that increases"),
        ("--allow-origin *", "--allow-origin must be hosts such as example.org"),
        ("--address ::1", "--address must be a host name or an IPv4 address"),
        ("--level semi --level semi", "--level must be one level, or two"),
    ],
)
def test_the_command_refuses_in_one_line(options, sentence):
    assert sentence in refusal("explore", "--no-show", *options.split())


def test_a_notebook_cannot_serve():
    async def cell():
        dt.explore(size=64).serve()

    with pytest.raises(RuntimeError, match="In a notebook the explorer is shown as output"):
        asyncio.run(cell())


def test_a_server_listens_where_it_is_told_only():
    async def made():
        found = server.made_server(
            lambda query: "page", address="127.0.0.1", port=0, origins=["example.org:8080"]
        )
        places = {each.getsockname()[:2] for each in found._http._sockets.values()}
        found.stop()
        return found.port, places, set(found._tornado._websocket_origins)

    port, places, origins = asyncio.run(made())
    assert places == {("127.0.0.1", port)}
    assert origins == {f"127.0.0.1:{port}", f"localhost:{port}", "example.org:8080"}


def test_a_page_on_a_server_is_changed_in_its_own_thread(monkeypatch):
    """What another thread adds to a document is lost while Panel holds the document's events."""
    threads = []
    document = SimpleNamespace(
        session_context=object(),
        add_next_tick_callback=lambda change: threads.append((threading.get_ident(), change())),
    )
    monkeypatch.setattr(page_thread, "pn", SimpleNamespace(state=SimpleNamespace(curdoc=document)))

    async def posted():
        outlet = page_thread.Outlet([])
        await asyncio.to_thread(outlet.post, lambda: "changed")
        await asyncio.sleep(0)

    asyncio.run(posted())
    assert threads == [(threading.get_ident(), "changed")]


def test_messages_to_a_notebook_are_taken_in_the_thread_of_the_page(monkeypatch):
    """JupyterLab delivers them in another one; Panel forgets all but the first event of each."""
    taken = []

    def on_msg(self, ref, manager, msg):
        taken.append((threading.get_ident(), ref, msg["content"]["events"], msg["buffers"]))

    monkeypatch.setattr(panel.Column, "_on_msg", on_msg)
    message = {"content": {"events": [1, 2], "references": []}, "buffers": 3}

    async def sent():
        layout = page_thread.PageLayout()
        layout.outlet = page_thread.Outlet([])
        await asyncio.to_thread(layout._on_msg, "ref", None, message)

    asyncio.run(sent())
    assert taken == [(threading.get_ident(), "ref", [number], 3) for number in (1, 2)]
