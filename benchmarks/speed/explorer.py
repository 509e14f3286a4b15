"""The explorer: time from a slider move to the picture, in a headless browser on this machine.

    python -m benchmarks.speed.explorer --small     a look
    python -m benchmarks.speed.explorer             all, some minutes on two cores
    python -m benchmarks.speed.explorer --write     the same, kept: results/explorer.md

It needs Chromium and playwright (`pip install -e '.[test]'`).
"""

import itertools
import math
import statistics
from typing import Any

from benchmarks import browsing
from benchmarks.reporting import measure, pages

WHOLE = "whole plane", ""
PART = "part of it", "&phi=0.1..2.7&w3=-0.1..0.5"
TWO = "whole plane, two levels", "&level=order-1&level=semi"
CASES = [(*view, size) for view in (WHOLE, PART, TWO) for size in (256, 512)]
SLIDER = "delta"
Record = dict[str, Any]

WATCH = """
({slider, picture}) => {
    const models = [...Bokeh.documents[0]._all_models.values()]
    const moved = models.find((m) => m.type == "Slider" && m.css_classes.includes(slider))
    const source = Bokeh.documents[0].get_model_by_name(picture)
    window.asked = []; window.drawn = []
    let last = 0  // when the mouse moved
    document.addEventListener("mousemove", (event) => { last = event.timeStamp }, true)
    moved.properties.value.change.connect(() => { window.asked.push([moved.value, last]) })
    source.properties.data.change.connect(() => {
        const about = JSON.parse(source.data.about[0])
        // Bokeh draws at the next frame, and at the one after it the picture has been shown.
        requestAnimationFrame(() => requestAnimationFrame((now) => {
            window.drawn.push({value: about.fixed.delta, size: about.size, final: about.final,
                at: performance.now()})
        }))
    })
}
"""


IS_FINISHED = """() => drawn.some((p) => p.final && asked.length
    && Math.abs(p.value - asked.at(-1)[0]) < 1e-9)"""  # not the fine edges of the one before


def measured(small: bool) -> Record:
    """All cases, one after the other, at one server."""
    if browsing.BROWSER is None:
        print("No Chromium on this machine, so nothing is measured.")
        raise SystemExit
    steps, seconds, rows = 5 if small else 60, 1.0 if small else 10.0, []
    with browsing.served() as (url, _), browsing.browser() as chromium:
        for name, query, size in CASES[::5] if small else CASES:
            visit = browsing.Visit.of(chromium, f"{url}?size={size}{query}")
            visit.final()
            visit.until(lambda visit=visit: "∂ω∞/∂δ" in visit.text(), "the start of the page")
            visit.page.evaluate(WATCH, {"slider": f"dt-slider-{SLIDER}", "picture": "picture-0"})
            row = {"name": name, "size": size, "load": measure.load()}
            rows.append(row | single(visit, size, steps) | moving(visit, seconds))
            assert visit.complaints == [], visit.complaints
            visit.close()
        return {"rows": rows, "browser": f"Chromium {chromium.version}"}


def single(visit: browsing.Visit, size: int, steps: int) -> Record:
    """Move the slider, wait for the finished picture, and measure when the pictures come."""
    x, y = visit.grasp(SLIDER)
    times: dict[str, list[float]] = {"first": [], "full": [], "final": []}
    for k in range(1, steps + 4):
        visit.page.evaluate("() => { asked.length = 0; drawn.length = 0 }")
        visit.page.mouse.move(x + 20 * (1 if k % 2 else -1) + k % 7, y)
        visit.until(lambda: visit.page.evaluate(IS_FINISHED), "a picture")
        (value, began), drawn = visit.page.evaluate("() => [asked.at(-1), drawn]")
        mine = [shown for shown in drawn if same(shown["value"], value)]
        wanted = {
            "first": mine,
            "full": [shown for shown in mine if shown["size"] == size],
            "final": [shown for shown in mine if shown["final"]],
        }
        if k > 3:  # the first moves compile, and measure the cost of a start
            for name, shown in wanted.items():
                times[name].append(shown[0]["at"] - began)
    visit.page.mouse.up()
    return {name: shares(values) for name, values in times.items()}


def moving(visit: browsing.Visit, seconds: float) -> Record:
    """Move the slider all the time, and measure the age of a picture's value when it is drawn."""
    x, y = visit.grasp(SLIDER)
    visit.page.evaluate("() => { asked.length = 0; drawn.length = 0 }")
    moves = int(seconds / 0.02)
    for k in range(moves):
        visit.page.mouse.move(x + 160 * abs((k / 100) % 2 - 1) - 80, y)
        visit.page.wait_for_timeout(16)
    visit.page.mouse.up()
    visit.page.wait_for_timeout(1000)
    asked, drawn = visit.page.evaluate("() => [asked, drawn]")
    # Values recur, and a picture comes a second time when it is refined.
    first = [b for a, b in itertools.pairwise(drawn) if b["value"] != a["value"]]
    ages, matched = [], -1  # pictures come in the order of requests
    for shown in first:
        later = range(matched + 1, len(asked))
        found = next((i for i in later if same(asked[i][0], shown["value"])), None)
        if found is not None:
            matched = found
            ages.append(shown["at"] - asked[found][1])
    return {
        "age": shares(ages),
        "pictures": 1000 * len(ages) / (asked[-1][1] - asked[0][1]),
        "pixels": statistics.median(shown["size"] for shown in first),
    }


def same(one: float, other: float) -> bool:
    """Return whether a value of the slider is that of a picture, which has no rounding errors."""
    return math.isclose(one, other, abs_tol=1e-9)


def shares(milliseconds: list[float]) -> Record:
    """Return the median and the 95 % quantile."""
    ordered = sorted(milliseconds)
    last = ordered[min(len(ordered) - 1, int(0.95 * len(ordered)))]
    return {"median": statistics.median(ordered), "95%": last}


if __name__ == "__main__":
    pages.command("explorer", measured)
