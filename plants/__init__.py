"""The language of plants: named balance equations, declared once, simulated, excited and recorded."""

from greygate.plants.curves import curve
from greygate.plants.excitation import band_limited_noise, chirp, multisine, prms
from greygate.plants.plant import Definition, Equation, Parameter, Plant, State
from greygate.plants.recording import Recording, read_csv
from greygate.plants.simulator import simulate

__all__ = [
    "Definition",
    "Equation",
    "Parameter",
    "Plant",
    "Recording",
    "State",
    "band_limited_noise",
    "chirp",
    "curve",
    "multisine",
    "prms",
    "read_csv",
    "simulate",
]
