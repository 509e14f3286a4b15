"""The explorer: a page in a browser or a notebook that maps outcomes while sliders move.

`scenes` says what is explored and `views` what a page shows of it; `drawing` computes `pictures`,
in `fair_queue` with other pages, and `starts` a single start; `recipes` and `addresses` write a
view down. All these know no browser. `page`, with its parts (`controls`, `maps`, `curves`), and
`server` are of Panel and Bokeh; they are imported when a page is opened.
"""

from .exploring import Explorer, explore

__all__ = ["Explorer", "explore"]
