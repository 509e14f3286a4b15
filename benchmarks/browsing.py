"""A real browser at a page of `dipoletop explore`: what it shows, and what a user does to it."""

import base64
import contextlib
import json
import os
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np

NAMES = "chromium", "chromium-browser", "google-chrome"
BROWSER = next((path for path in map(shutil.which, NAMES) if path), None)
OPTIONS = [
    "--no-sandbox",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-default-apps",
    "--disable-dev-shm-usage",
]
MODEL = "const named = (name) => Bokeh.documents.at(-1).get_model_by_name(name);"
PATIENCE = 180.0  # seconds; the first picture of a process compiles, on a busy machine


@contextlib.contextmanager
def served(*options: str):
    """The address of a page that is served by a process of its own."""
    command = [sys.executable, "-c", "from dipoletop.cli import main; main()", "explore"]
    command += ["--no-show", *options]
    environment = os.environ | {"DIPOLETOP_CACHE": "off", "PYTHONUNBUFFERED": "1"}
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    )
    assert process.stdout is not None
    try:
        line = process.stdout.readline()
        if "http://" not in line:
            process.kill()
            raise RuntimeError(process.communicate()[1])
        yield line.split()[2], process
    finally:
        process.terminate()
        try:
            process.communicate(timeout=60)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            raise


@contextlib.contextmanager
def browser():
    """A headless browser without anything of another one."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=BROWSER, args=OPTIONS)
        try:
            yield chromium
        finally:
            chromium.close()


def screenshot(path: str) -> None:
    """Write the picture of a page with its first start."""
    with served() as (url, _), browser() as chromium:
        visit = Visit.of(chromium, url, 1280)
        visit.until(lambda: "∂ω∞/∂δ" in visit.text(), "a start")
        visit.page.screenshot(path=path, full_page=True)


@dataclass
class Visit:
    """One user at a page."""

    page: Any
    complaints: list[str] = field(default_factory=list)
    """What the console of the browser has said of errors and warnings."""

    @classmethod
    def of(cls, chromium: Any, url: str, width: int = 1400, height: int = 900) -> "Visit":
        """Open a page, with a profile of its own."""
        page = chromium.new_context(viewport={"width": width, "height": height}).new_page()
        page.set_default_timeout(1000 * PATIENCE)
        visit = cls(page)
        page.on("pageerror", lambda error: visit.complaints.append(str(error)))
        page.on("console", visit._console)
        page.on("requestfailed", lambda request: visit.complaints.append(f"lost {request.url}"))
        page.goto(url)
        return visit

    def _console(self, message: Any) -> None:
        if message.type in ("error", "warning"):
            self.complaints.append(message.text)

    def close(self) -> None:
        """Leave."""
        self.page.context.close()

    def about(self, number: int = 0) -> dict[str, Any] | None:
        """Which picture is drawn: fixed values, size, whether it is final, its place."""
        found = self.page.evaluate(
            f"""() => {{
                if (!window.Bokeh || !Bokeh.documents.length) return null
                {MODEL}
                const source = named("picture-{number}")
                if (!source || !source.data.serial || !source.data.serial.length) return null
                const d = source.data
                return JSON.stringify({{about: JSON.parse(d.about[0]), serial: d.serial[0],
                    x: d.x[0], y: d.y[0], dw: d.dw[0], dh: d.dh[0]}})
            }}"""
        )
        if found is None:
            return None
        flat = json.loads(found)
        return flat.pop("about") | flat

    def until(self, wanted: Any, what: str = "", patience: float = PATIENCE) -> Any:
        """What `wanted` gives once it gives something true."""
        end = time.monotonic() + patience
        while not (found := wanted()):
            if time.monotonic() > end:
                seen = self.text()[-600:]
                raise AssertionError(
                    f"{what} did not come: {self.about()}, {self.complaints}: {seen}"
                )
            self.page.wait_for_timeout(20)
        return found

    def final(self, fine: bool = False, **fixed: float) -> dict[str, Any]:
        """The finished picture at some fixed values, if wanted with its fine edges."""

        def wanted():
            about = self.about()
            good = about and about["fine_edges" if fine else "final"]
            if good and all(abs(about["fixed"][k] - v) < 1e-9 for k, v in fixed.items()):
                return about
            return None

        return self.until(wanted, f"the picture at {fixed}")

    def pixels(self, number: int = 0) -> np.ndarray:
        """The colours of the picture that is drawn, RGBA, first row at the bottom."""
        found = self.page.evaluate(
            f"""() => {{
                {MODEL}
                const image = named("picture-{number}").data.image[0]
                const bytes = new Uint8Array(image.buffer, image.byteOffset, image.byteLength)
                let text = ""  // in base 64: a list of numbers takes a minute
                for (let k = 0; k < bytes.length; k += 0x4000)
                    text += String.fromCharCode(...bytes.subarray(k, k + 0x4000))
                return [image.shape, btoa(text)]
            }}"""
        )
        shape, text = found
        return np.frombuffer(base64.b64decode(text), np.uint8).reshape(*shape, 4)

    def slider(self, symbol: str) -> Any:
        """The handle of the slider of a quantity."""
        return self.page.locator(f".dt-slider-{symbol} .noUi-handle").first

    def grasp(self, symbol: str) -> tuple[float, float]:
        """Press the mouse on a slider; where that is."""
        box = self.slider(symbol).bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        self.page.mouse.move(x, y)
        self.page.mouse.down()
        return x, y

    def drag(self, symbol: str, pixels: float, steps: int = 10) -> None:
        """Move a slider with the mouse."""
        x, y = self.grasp(symbol)
        for k in range(1, steps + 1):
            self.page.mouse.move(x + pixels * k / steps, y)
            self.page.wait_for_timeout(15)
        self.page.mouse.up()

    def value(self, symbol: str) -> float:
        """The value of a slider in the browser."""
        return self.page.evaluate(
            """(css) => {
                const models = [...Bokeh.documents.at(-1)._all_models.values()]
                return models.find((m) => m.css_classes && m.css_classes.includes(css)
                    && m.type == "Slider").value
            }""",
            f"dt-slider-{symbol}",
        )

    def place(self, x: float, y: float, number: int = 0) -> tuple[float, float]:
        """Where in the window a point of a map is, in CSS pixels; x and y from 0 to 1."""
        box = self.page.evaluate(
            f"""() => {{
                {MODEL}
                const view = Bokeh.index.find_one
                    ? Bokeh.index.find_one(named("map-{number}")) : null
                const frame = view.frame.bbox
                const origin = view.el.getBoundingClientRect()
                return [origin.x + frame.left, origin.y + frame.top, frame.width, frame.height]
            }}"""
        )
        left, top, width, height = box
        return left + x * width, top + (1 - y) * height

    def ranges(self) -> tuple[float, float, float, float]:
        """The ranges that the axes of the map show."""
        return tuple(
            self.page.evaluate(
                f"""() => {{
                    {MODEL}
                    const plot = named("map-0")
                    return [plot.x_range.start, plot.x_range.end,
                            plot.y_range.start, plot.y_range.end]
                }}"""
            )
        )

    def text(self) -> str:
        """All text of the page that can be seen, shadow roots included."""
        return self.page.evaluate(
            """() => {
                const parts = []
                const walk = (node) => {
                    if (node.nodeType == 3) parts.push(node.textContent)
                    if (node.nodeType == 1 && ["STYLE", "SCRIPT"].includes(node.tagName)) return
                    if (node.nodeType == 1 && getComputedStyle(node).display == "none") return
                    if (node.shadowRoot) node.shadowRoot.childNodes.forEach(walk)
                    node.childNodes.forEach(walk)
                }
                walk(document.body)
                return parts.join(" ")
            }"""
        )
