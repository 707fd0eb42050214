"""What can be asked of position control: who controls, where it is computed, what disturbs the machine."""

from enum import StrEnum

JUDGED = 1000  # what is judged has seeds from here on; controllers are tuned and learnt on smaller ones


class Case(StrEnum):
    """What disturbs the machine."""

    NOMINAL = "nominal"
    LOAD = "load"
    SUPPLY = "supply"


class Method(StrEnum):
    """Who controls."""

    PI = "pi"
    MPC = "mpc"
    NETWORK = "network"


class Place(StrEnum):
    """Where soft sensor and imitating network are computed."""

    FLOAT = "float"
    EMULATOR = "emulator"
    RTL = "rtl"
