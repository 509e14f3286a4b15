"""The explorer: a page in a browser or a notebook that maps outcomes while sliders move.

`scenes` defines the problem and `views` the part of it that a page shows. `drawing` computes the
`pictures`, with finer `edges`, taking turns with other pages in `fair_queue`, and `starts` a single
start. `recipes` writes a view as code. None of these needs a browser. `page`, with its parts
(`controls`, `maps`, `curves`, `chosen_start`, all of `pieces`), and `server` use Panel and Bokeh;
they are imported when a page is opened.
"""

from .exploring import Explorer, explore

__all__ = ["Explorer", "explore"]
