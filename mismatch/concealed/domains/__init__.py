"""Six small machines of other fields, each with its plant as a file, as a user would write it, and its own simulation.

NAME.toml is what a diagnosis reads. The equations in NAME.py are written once more, with the effects that it may hide.
"""

from ..rig import ConcealedRig
from .electrical import ELECTRICAL
from .motor import MOTOR
from .pendulum import PENDULUM
from .quarter_car import QUARTER_CAR
from .tank import TANK
from .thermal import THERMAL

DOMAINS: dict[str, ConcealedRig] = {rig.plant: rig for rig in (MOTOR, THERMAL, ELECTRICAL, TANK, PENDULUM, QUARTER_CAR)}
