"""`dipoletop explore`: a page in the browser that maps outcomes while sliders move."""

from typing import Any

import click

from .._maps.top_parameters import QUANTITIES
from ..equations.levels import Level
from . import quantities
from .parameters import Number
from .refusals import Refusal, computing

AXIS = click.Choice(list(quantities.OPTIONS))
LEVELS = click.Choice([level.value for level in Level if level is not Level.FULL])


@click.command("explore", short_help="Maps in the browser that follow sliders.")
@click.option(
    "--level",
    "levels",
    type=LEVELS,
    metavar="LEVEL",
    multiple=True,
    default=("semi",),
    help="Level of the equation at first; give two to compare them.",
)
@click.option("--x", type=AXIS, metavar="AXIS", help="Horizontal axis at first.  [default: phi]")
@click.option("--y", type=AXIS, metavar="AXIS", help="Vertical axis at first.  [default: w3]")
@click.option(
    "--range",
    "ranges",
    type=(AXIS, Number(), Number()),
    multiple=True,
    metavar="AXIS LOW HIGH",
    help="Range of an axis or a slider; may be given for each.",
)
@quantities.quantity_options
@click.option(
    "--size",
    type=click.Choice(["64", "128", "256", "512", "1024"]),
    default="256",
    help="Starts on each axis at first.",
)
@click.option("--rtol", type=Number(), default="1e-8", help="Relative tolerance at first.")
@click.option(
    "--address",
    default="127.0.0.1",
    help="Where to listen. There is no password: others than 127.0.0.1 let other machines in.",
)
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="Port; 0: any free one.")
@click.option(
    "--allow-origin",
    "origins",
    multiple=True,
    metavar="HOST[:PORT]",
    help="Host whose pages may open a session, too, as behind a proxy; may be given several times.",
)
@click.option("--show/--no-show", default=True, help="Open a browser.")
@computing
def explore_command(**options: Any) -> None:
    """Explore the outcomes of the transverse top in a browser: which starts keep rotating?

    A page with the map over any two quantities and sliders for the others; the picture follows
    them. A click on a start shows its motion. Zoom in as far as rounding allows. Ctrl-C ends it.
    """
    from ..explorer import explore

    over: dict[str, Any] = {name: options[name] for name in QUANTITIES if options[name] is not None}
    over |= {quantities.OPTIONS[word]: (low, high) for word, low, high in options["ranges"]}
    axes = {axis: options[axis] and quantities.OPTIONS[options[axis]] for axis in ("x", "y")}
    try:
        explorer = explore(
            None,
            over,
            level=options["levels"],
            size=int(options["size"]),
            rtol=options["rtol"],
            **axes,
        )
    except ImportError as error:
        raise Refusal(str(error)) from None
    place = {name: options[name] for name in ("address", "port", "origins", "show")}
    explorer.serve(**place, say=lambda url: click.echo(f"Explore at {url} (Ctrl-C ends it)."))
