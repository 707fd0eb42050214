"""Plants: declared once as named balance equations, simulated, excited and recorded."""

from greygate.plants.excitation import (
    band_limited_noise,
    band_limited_noise_spectrum,
    chirp,
    chirp_spectrum,
    multisine,
    multisine_spectrum,
    prms,
    prms_spectrum,
)
from greygate.plants.plant import Definition, Equation, Parameter, Plant, State
from greygate.plants.recording import Recording, read_csv
from greygate.plants.scenarios import measure, scenario
from greygate.plants.simulate import simulate
from greygate.plants.valve_cylinder import spool_discrete, valve_cylinder

__all__ = [
    "Definition",
    "Equation",
    "Parameter",
    "Plant",
    "Recording",
    "State",
    "band_limited_noise",
    "band_limited_noise_spectrum",
    "chirp",
    "chirp_spectrum",
    "measure",
    "multisine",
    "multisine_spectrum",
    "prms",
    "prms_spectrum",
    "read_csv",
    "scenario",
    "simulate",
    "spool_discrete",
    "valve_cylinder",
]
