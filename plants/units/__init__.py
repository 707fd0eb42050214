"""Units: what a text says (`reading`), what it is worth (`quantities`), and what an expression has (`algebra`).

units.toml holds the symbols and every way in which they are written; no other unit is known.
"""

from greygate.plants.units.algebra import Powers as Powers
from greygate.plants.units.algebra import of as of
from greygate.plants.units.algebra import powers as powers
from greygate.plants.units.algebra import times as times
from greygate.plants.units.algebra import written as written
