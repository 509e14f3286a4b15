"""What acts on a real body: its own radiation, a gas, the thermal radiation around it.

Each member gives the torque on a body, and the noise that belongs to it: in a bath of one
temperature friction and noise together keep the thermal equilibrium. `balance` compares the
members at one rotation.
"""

from .balance import Balance, balance
from .blackbody import Blackbody
from .gas import AIR, Gas
from .radiation_reaction import RadiationReaction
from .surrounding import Surrounding

__all__ = [
    "AIR",
    "Balance",
    "Blackbody",
    "Gas",
    "RadiationReaction",
    "Surrounding",
    "balance",
]
