"""The site in a browser: links, pictures, its search, and that nothing overflows on a phone.

    python tests/browse.py build/site

Needs Chromium and playwright (`pip install -e '.[docs]'`). The network is closed to the browser, so
the site must be complete by itself.
"""

import argparse
import functools
import http.server
import shutil
import sys
import threading
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urldefrag, urlsplit

from playwright.sync_api import Page, sync_playwright

DESKTOP, PHONE = (1280, 800), (390, 844)
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
OPTIONS = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
LISTINGS = ("_modules/", "genindex", "py-modindex", "search.html")
"""Pages that Sphinx makes from others: their links are checked, but no browser opens them."""
SOUGHT = {"float64": "questions.html", "units": "questions.html", "explorer": "explorer.html"}
"""Words for which the search must find a page."""
BROKEN_PICTURES = """() => [...document.images]
    .filter(x => !x.complete || x.naturalWidth === 0).map(x => x.getAttribute("src"))"""
BAD_FORMULAS = """() => [...document.querySelectorAll("article .math")]
    .filter(x => !x.querySelector("mjx-container")
        || x.querySelector("mjx-merror, mjx-mtext[style*=red]")).map(x => x.textContent)"""
"""Formulas that MathJax does not read: with unbalanced braces, an error, an unknown command."""
SETTLED = """async () => {
    document.querySelectorAll("img[loading=lazy]").forEach(x => x.loading = "eager");
    if (window.MathJax?.startup) await MathJax.startup.promise;
    await Promise.all([...document.images].map(x => x.decode().catch(() => {})));
}"""
WIDER = """() => {
    const room = document.documentElement.clientWidth, main = document.querySelector("article");
    const scrolls = x => x && x !== main && x.parentElement
        && (getComputedStyle(x).overflowX !== "visible" || scrolls(x.parentElement));
    const wide = [...(main ?? document.body).querySelectorAll("*")].filter(
        x => x.getBoundingClientRect().right > room + 1 && !scrolls(x.parentElement)
            && !x.closest("mjx-assistive-mml"));  // for readers of screens, not shown
    const names = wide.slice(0, 3).map(x => `${x.tagName.toLowerCase()} ${x.className}`.trim());
    return document.documentElement.scrollWidth > room ? ["the page", ...names] : names;
}"""
"""What sticks out of the page on the right, unless it is inside of a thing that scrolls."""


class Links(HTMLParser):
    """What a page links to, and what may be linked to in it."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.targets: list[str] = []
        self.anchors: set[str] = {""}
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note the attributes of an element."""
        for name, value in attrs:
            if name in ("href", "src") and value:
                self.targets.append(value)
            elif name in ("id", "name") and value:
                self.anchors.add(value)


def dead_links(site: Path) -> Iterator[str]:
    """Links inside the site that lead nowhere."""
    pages = {path: Links(path) for path in sorted(site.rglob("*.html"))}
    for path, page in pages.items():
        for target in sorted(set(page.targets)):
            if urlsplit(target).scheme or target.startswith(("//", "data:")):
                continue
            file, anchor = urldefrag(target)
            goal = (path.parent / unquote(file.split("?")[0])).resolve() if file else path
            if not goal.exists():
                yield f"{path.relative_to(site)} links to {target}, which does not exist"
            elif goal in pages and unquote(anchor) not in pages[goal].anchors:
                yield f"{path.relative_to(site)} links to {target}, which has no such place"


def faults(page: Page, address: str, name: str) -> Iterator[str]:
    """What a browser finds wrong with a page, wide and narrow."""
    said: list[str] = []
    page.on("console", lambda message: said.append(message.text) if is_bad(message) else None)
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("requestfailed", lambda request: said.append(f"{request.url} cannot be loaded"))
    page.set_viewport_size({"width": DESKTOP[0], "height": DESKTOP[1]})
    page.goto(f"{address}/{name}")
    page.evaluate(SETTLED)
    yield from (f"{name}: {text}" for text in said)
    yield from (f"{name}: picture {source} is broken" for source in page.evaluate(BROKEN_PICTURES))
    yield from (f"{name}: formula: {text}" for text in page.evaluate(BAD_FORMULAS))
    for width, height in (DESKTOP, PHONE):
        page.set_viewport_size({"width": width, "height": height})
        wider = page.evaluate(WIDER)
        if wider:
            yield f"{name} is wider than {width} pixels: {', '.join(wider)}"


def not_found(page: Page, address: str) -> Iterator[str]:
    """The words for which the search of the site does not find their page."""
    for word, wanted in SOUGHT.items():
        page.goto(f"{address}/search.html?q={word}")
        page.wait_for_selector("#search-results p.search-summary")
        page.wait_for_timeout(500)  # results come one by one
        links = page.eval_on_selector_all("#search-results a", "x => x.map(a => a.href)")
        if not any(wanted in link for link in links):
            yield f"the search for {word} does not find {wanted}"


def is_bad(message: object) -> bool:
    """Whether a message of the console is an error."""
    return getattr(message, "type", "") == "error"


def served(site: Path) -> http.server.ThreadingHTTPServer:
    """A server of the site on a free port of this machine."""

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *args: object) -> None:
            """Say nothing."""

    handler = functools.partial(Quiet, directory=str(site))
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    return server


def seen(site: Path, names: list[str]) -> Iterator[str]:
    """The faults of all pages."""
    program = next(filter(None, map(shutil.which, BROWSERS)), None)
    if program is None:
        sys.exit("No Chromium on this machine: apt-get install chromium")
    server = served(site)
    address = f"http://127.0.0.1:{server.server_port}"
    with sync_playwright() as library:
        browser = library.chromium.launch(executable_path=program, args=list(OPTIONS))
        context = browser.new_context()
        context.route(lambda url: not url.startswith(address), lambda route: route.abort())
        for name in names:
            page = context.new_page()
            yield from faults(page, address, name)
            page.close()
        yield from not_found(context.new_page(), address)
        browser.close()
    server.shutdown()


def main() -> None:
    """Check a site."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("site", type=Path, help="the folder that Sphinx wrote")
    site = parser.parse_args().site.resolve()
    names = sorted(str(path.relative_to(site)) for path in site.rglob("*.html"))
    opened = [name for name in names if not name.startswith(LISTINGS)]
    found = [*dead_links(site), *seen(site, opened)]
    print("\n".join(found))
    if found:
        sys.exit(f"{len(found)} faults")
    print(f"{len(names)} pages, {len(opened)} of them opened at two widths: no fault")


if __name__ == "__main__":
    main()
