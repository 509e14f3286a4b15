"""Results that notebooks show with a picture."""

from importlib import import_module


class Pictured:
    """A result that a notebook shows as its text and a small picture."""

    def _repr_html_(self) -> str:
        # By name and when it is asked for: results know nothing of how they are drawn.
        return import_module("dipoletop.plots.in_notebooks").html_of(self)
