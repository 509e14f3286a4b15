"""The page in a real browser: slider, click, zoom, code, users, bad addresses, foreign pages."""

import contextlib
import http.client
import json
import re
import signal
import urllib.parse
import urllib.request
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import dipoletop as dt
from benchmarks import browsing
from dipoletop.explorer import pictures, recipes, scenes, views

pytestmark = pytest.mark.system
TOP = scenes.scene_of_top({})
SMALL = replace(views.first_view(TOP, levels=("semi",)), size=128)


def expected_image(view):
    """The picture of a view, from `dt.sweep` itself."""
    cells = views.cells_of(TOP, view, view.size)
    basins = [dt.sweep(TOP.problem_at(level), cells.grid, rtol=view.rtol) for level in view.levels]
    return pictures.picture_of(view, basins, cells.folded, view.size, True).images[0]


def data(visit, name, column):
    """A column of a source in the browser."""
    code = f"() => {{ {browsing.MODEL} return Array.from(named('{name}').data.{column}) }}"
    return visit.page.evaluate(code)


def starts(visit, number=0):
    """The colours of a map's starts; with fine edges each is the middle one of nine."""
    return visit.pixels(number)[1::3, 1::3]


def chosen(visit):
    """The start that is marked."""
    return data(visit, "chosen", "x")[0], data(visit, "chosen", "y")[0]


def enter(visit, delta):
    """Type a value of δ."""
    box = visit.page.locator(".dt-value-delta input")
    box.fill(delta)
    box.press("Enter")


def test_a_slider_redraws_what_a_sweep_gives(visit):
    visit.final(fine=True)
    before = starts(visit)
    np.testing.assert_array_equal(before, expected_image(SMALL))
    visit.drag("w_perp", 40)
    value = visit.value("w_perp")
    assert value == round(value, 3) >= 0.24  # a multiple of the step, without rounding errors
    visit.final(fine=True, w_perp=value)
    after = starts(visit)
    assert np.mean(np.any(before != after, axis=2)) > 0.05
    values = SMALL.values | {"w_perp": value}
    np.testing.assert_array_equal(after, expected_image(replace(SMALL, values=values)))


def test_pictures_come_while_a_slider_moves(visit):
    serials = set()
    box = visit.slider("delta").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    visit.page.mouse.move(x, y)
    visit.page.mouse.down()
    for k in range(40):
        visit.page.mouse.move(x - k, y)
        visit.page.wait_for_timeout(30)
        serials.add(visit.about()["serial"])
    assert len(serials) >= 5
    visit.page.mouse.up()
    visit.final(delta=visit.value("delta"))


def test_exact_values_are_taken_and_bad_ones_refused(visit):
    enter(visit, "-1/3")
    visit.until(lambda: "Argument `delta` must be a finite number" in visit.text(), "a refusal")
    enter(visit, "1")
    visit.until(
        lambda: "Argument `delta` must lie in [-1, 1), but is 1." in visit.text(), "another"
    )
    assert visit.about()["fixed"]["delta"] == -0.2
    enter(visit, "-0.123456789")
    visit.final(delta=-0.123456789)
    visit.until(lambda: "must lie" not in visit.text(), "the picture in place of the refusal")


def test_a_click_shows_the_start(visit):
    x, y = visit.place(0.05, 0.9)  # far from the dipole's plane of rotation, fast: it stops
    visit.until(lambda: "∂ω∞/∂δ" in visit.text(), "that of the first start")
    visit.page.mouse.click(x, y)
    there = pytest.approx((0.1 * np.pi, 0.48), abs=0.02)
    visit.until(lambda: chosen(visit) == there, "the mark")
    phi, w3 = chosen(visit)
    visit.until(lambda: data(visit, "omega", "w3")[0] == pytest.approx(w3), "the motion")
    visit.until(lambda: "∂ω∞/∂δ" in visit.text(), "derivatives")
    verdict = dt.classify(dt.TransverseSemi(-0.2), dt.cylindrical(0.2, w3, phi))
    assert dt.Outcome(int(verdict.outcome)).name.lower() in visit.text()
    curves = visit.page.evaluate(
        f"""() => {{ {browsing.MODEL}
            const w = named("omega").data, e = named("energy").data, b = named("lines").data
            return [w.w3[0], w.tau.length, e.energy[0], e.energy[e.energy.length - 1],
                    b.x0.length]
        }}"""
    )
    assert curves[0] == pytest.approx(w3)
    assert curves[1] > 100
    assert curves[2] > curves[3] > 0
    assert curves[4] > 100


def test_a_page_opens_with_a_start_whose_body_turns(visit):
    """That of figure 2a; its path on the map ends where ω lies along the dipole."""
    visit.until(lambda: data(visit, "path", "x"), "the path")
    assert chosen(visit) == pytest.approx((np.pi / 30, 0.2))
    assert data(visit, "path", "y")[0] == pytest.approx(0.2)
    assert data(visit, "path", "y")[-1] == pytest.approx(0.0, abs=1e-3)
    first = visit.until(lambda: data(visit, "arrows", "x1"), "the body")
    visit.until(lambda: data(visit, "arrows", "x1") != first, "a motion")


def test_the_chosen_start_and_the_address_follow_the_view(visit):
    visit.until(lambda: "∂ω∞/∂δ" in visit.text(), "derivatives")
    before = visit.page.url
    enter(visit, "-0.1")
    visit.final(delta=-0.1)
    visit.until(lambda: "δ = −0.1, ω⊥ = 0.2, ω₃ = 0.2" in visit.text(), "the start")
    verdict = dt.classify(dt.TransverseSemi(-0.1), dt.cylindrical(0.2, 0.2, np.pi / 30))
    visit.until(lambda: f"{float(verdict.omega_inf):.9f}"[:8] in visit.text(), "its end")
    visit.until(lambda: "delta=-0.1" in visit.page.url, "the address")
    with visit.page.expect_event("load"):  # the page opens anew at the earlier address
        visit.page.go_back()
    visit.final(delta=-0.2)
    assert "delta=-0.2" in before


def test_pictures_and_data_are_given_away(visit):
    for suffix, start in (("png", b"\x89PNG"), ("pdf", b"%PDF"), ("csv", b"delta,w_perp,w3,phi")):
        with visit.page.expect_download() as waiting:
            visit.page.get_by_text(suffix.upper(), exact=True).click()
        content = Path(waiting.value.path()).read_bytes()
        assert content.startswith(start)
        assert waiting.value.suggested_filename == f"dipoletop-map.{suffix}"
    assert len(content.splitlines()) == 1 + SMALL.size**2 // 4  # half a turn, ω₃ > 0


def test_an_example_is_shown(visit):
    box = visit.page.locator("select").first
    box.select_option("Figure 2b of the paper: it stops")
    visit.until(lambda: _with(visit, "Order 1 lacks a leading term"), "the picture")
    visit.until(lambda: "outcome stop" in " ".join(visit.text().split()), "the start")


def test_a_slider_plays_there_and_back(visit):
    first = visit.value("delta")
    play = visit.page.locator(".dt-play-delta button")
    play.click()
    visit.until(lambda: visit.value("delta") > first + 0.05, "a motion")
    play.click()
    value = visit.value("delta")
    visit.final(delta=value)
    visit.page.wait_for_timeout(300)
    assert visit.value("delta") == value


def test_the_pointer_shows_how_a_start_ends(visit):
    about = visit.final(fine=True)
    columns = dt.sweep(TOP.problem_at(dt.Level.SEMI), dt.Grid(**_point(about, 0.403, 0.602)))
    visit.page.mouse.move(*visit.place(0.403, 0.602))
    text = visit.until(lambda: _with(visit, "ω∞ = −"), "the end of a start")
    told = float(re.search(r"residual rotation, ω∞ = −([\d.]+)", text)[1])
    assert told == pytest.approx(-columns.omega_inf.item(), abs=0.005)
    assert "φ = 2.528, ω₃ = 0.1266" in text  # the middle of its pixel
    visit.page.mouse.move(*visit.place(0.403, 0.98))
    visit.until(lambda: "ω₃ = 0.5766 stop, rotating" in " ".join(visit.text().split()), "a stop")


def _point(about, x, y):
    place = {"phi": about["x"] + x * about["dw"], "w3": about["y"] + y * about["dh"]}
    return {name: [value] for name, value in (place | about["fixed"]).items()}


def test_a_dark_page_stays_dark(opened):
    visit = opened("?size=128&theme=dark")
    visit.final()
    colour = visit.page.evaluate("() => getComputedStyle(document.body).backgroundColor")
    assert max(int(part) for part in re.findall(r"\d+", colour)[:3]) < 60
    visit.until(lambda: "w3=" in visit.page.url, "the address")
    assert visit.page.url.endswith("theme=dark")
    visit.page.get_by_role("button", name="Dark or light").click()
    visit.until(lambda: "theme" not in visit.page.url, "a light page")
    visit.final()


def test_a_phone_sees_a_page_of_its_width(chromium, server):
    size = {"viewport": {"width": 390, "height": 844}, "is_mobile": True}
    page = chromium.new_context(**size).new_page()
    page.set_default_timeout(1000 * browsing.PATIENCE)
    page.goto(f"{server[0]}?size=64")
    page.locator(".dt-slider-delta").wait_for()
    assert page.evaluate("document.documentElement.scrollWidth") == 390
    assert page.locator(".dt-slider-delta").bounding_box()["y"] < 300
    page.context.close()


def test_a_page_says_that_its_server_has_stopped(chromium):
    with browsing.served("--size", "64") as (url, process):
        visit = browsing.Visit.of(chromium, url)
        visit.until(visit.about, "a picture")
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=60) == 0
        visit.until(lambda: "The server has stopped" in visit.page.content(), "the note")
        visit.close()


def test_a_zoom_computes_again_at_the_new_range(visit):
    visit.page.mouse.move(*visit.place(0.5, 0.5))
    visit.page.mouse.wheel(0, -400)
    left, right, bottom, top = visit.until(
        lambda: visit.ranges() if visit.ranges()[1] < 6 else None, "the zoom"
    )
    assert right - left < 2 * np.pi
    about = visit.until(lambda: _final_at(visit, left, right), "the picture there")
    assert (about["y"], about["dh"]) == pytest.approx((bottom, top - bottom))
    view = replace(SMALL, ranges={"phi": (left, right), "w3": (bottom, top)})
    np.testing.assert_array_equal(starts(visit), expected_image(view))
    visit.page.get_by_role("button", name="Whole range").click()
    visit.until(lambda: visit.ranges() == pytest.approx((0, 2 * np.pi, -0.6, 0.6)), "all")


def _final_at(visit, left, right):
    about = visit.about()
    there = about["x"] == left and about["dw"] == pytest.approx(right - left)
    return about if there and about["fine_edges"] else None


def test_rounding_ends_the_zoom_and_the_page_says_so(opened):
    low, high = 0.3, 0.3 + 128 * 5 * float(np.spacing(0.3))
    visit = opened(f"?size=128&phi={low!r}..{high!r}&w3=0.2..{0.2 + 1e-13!r}")
    visit.final()
    visit.page.mouse.move(*visit.place(0.5, 0.5))
    for _ in range(6):
        visit.page.mouse.wheel(0, -400)
        visit.page.wait_for_timeout(50)
    visit.until(lambda: "Rounding ends the zoom in φ" in visit.text(), "the end of the zoom")
    left, right, *_ = visit.ranges()
    assert right - left >= 128 * 4 * np.spacing(0.3)


def test_two_levels_side_by_side(opened):
    visit = opened("?size=128&level=order-1&level=semi")
    visit.final(fine=True)
    text = visit.until(lambda: _with(visit, "The outcome differs for"), "the share")
    assert "Order 1 lacks a leading term of the full equation." in text
    assert "Semi-reduced" in text
    view = replace(SMALL, levels=(dt.Level.ORDER_1, dt.Level.SEMI))
    expected = expected_image(view)
    plain = np.any(expected[..., :3] % 255 != 0, axis=2)  # outside of the hatching, which is finer
    unhatched = plain & np.any(starts(visit)[..., :3] % 255 != 0, axis=2)
    assert unhatched.mean() > 0.9 * plain.mean() > 0.8
    np.testing.assert_array_equal(starts(visit)[unhatched], expected[unhatched])
    black = np.all(visit.pixels(0)[..., :3] == 0, axis=2)
    assert black.any()
    np.testing.assert_array_equal(black, np.all(visit.pixels(1)[..., :3] == 0, axis=2))


def _with(visit, words):
    text = visit.text()
    return text if words in text else None


def test_the_code_button_writes_the_code_of_the_view(visit):
    """`test_recipes` runs it."""
    visit.page.get_by_role("button", name="Write code").click()
    code = visit.until(lambda: visit.page.locator(".dt-code").text_content(), "the code")
    assert code == recipes.code_of(TOP, SMALL)
    href = visit.page.locator("a", has_text="address of this view").get_attribute("href")
    query = urllib.parse.parse_qs(href.removeprefix("?"))
    assert query["size"] == ["128"]


@pytest.mark.parametrize(
    ("query", "sentence"),
    [
        ("size=1e9", "Argument `size` must be one of 64, 128, 256, 512, 1024"),
        ("delta=<script>alert(1)</script>", "but is '<script>alert(1)</script>'."),
    ],
)
def test_bad_addresses_are_refused_in_a_sentence(opened, query, sentence):
    visit = opened(f"?{query}")
    visit.until(lambda: sentence in visit.text(), "the refusal")
    assert visit.about() is None


def test_a_second_user_is_served_while_the_first_one_computes(opened):
    slow = "?size=1024&level=order-4&level=order-3&phi=0.1..3&w3=0.01..0.6&rtol=1e-11"
    first = opened(slow)
    first.until(first.about, "a coarse picture")
    second = opened("?size=64&delta=-0.31")
    second.final(delta=-0.31)
    assert not first.about()["final"]
    second.drag("delta", 20)
    second.final(delta=second.value("delta"))


def handshake(url, origin):
    """The status of a websocket that a page of some origin opens."""
    place = urllib.parse.urlparse(url)
    with urllib.request.urlopen(url, timeout=60) as page:
        html = page.read().decode()
    token = json.loads(html.split('"token":')[1].split(",")[0].split("}")[0])
    connection = http.client.HTTPConnection(place.hostname, place.port, timeout=60)
    headers = {
        "Connection": "Upgrade",
        "Upgrade": "websocket",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
        "Sec-WebSocket-Protocol": f"bokeh, {token}",
        "Origin": origin,
    }
    with contextlib.closing(connection):
        connection.request("GET", "/ws", headers=headers)
        with contextlib.closing(connection.getresponse()) as answer:
            return answer.status


def test_pages_of_foreign_origins_open_no_session(server):
    url = server[0]
    port = urllib.parse.urlparse(url).port
    assert handshake(url, f"http://127.0.0.1:{port}") == 101
    assert handshake(url, f"http://localhost:{port}") == 101
    for origin in ("http://evil.example", f"http://evil.example:{port}", "http://127.0.0.1:1"):
        assert handshake(url, origin) == 403


def test_interrupting_ends_the_server_quietly():
    with browsing.served("--size", "64") as (url, process):
        assert handshake(url, url.rstrip("/")) == 101
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=60)
        assert process.returncode == 0
        assert "Traceback" not in said
