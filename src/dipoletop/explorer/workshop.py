"""What all pages of an explorer share."""

from dataclasses import dataclass, field

from .drawing import Drawing
from .fair_queue import Turns
from .pictures import Picture
from .scenes import Scene


@dataclass
class Workshop:
    """The objects that all pages of an explorer share."""

    scene: Scene
    drawing: Drawing
    turns: Turns = field(default_factory=Turns)
    """The work of pictures."""
    starts: Turns = field(default_factory=Turns)
    """The work of chosen starts."""
    picture: Picture | None = None
    """The last finished picture of any page."""
