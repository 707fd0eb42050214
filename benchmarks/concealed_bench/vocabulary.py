"""The names that an answer is scored by, with what they mean."""

from collections.abc import Mapping

from greygate.mismatch.concealed.conceal import EVERY_RIG

LATE, PICKUP = "late_channel", "line_pickup"  # names of what a recording may have
FAULTS = {
    LATE: "one recorded channel comes later than the others",
    PICKUP: "one recorded channel picks up a wave of constant frequency, such as that of the mains",
}
MEANS = {
    "internal_leakage": "laminar leakage between the chambers past the piston",
    "cylinder_leakage": "laminar leakage between the cylinder chambers",
    "external_leakage": "laminar leakage from both chambers to tank",
    "turbulent_leakage": "leakage across pump 2 that grows with the root of the pressure difference",
    "valve_overlap": "spool lands longer than the ports",
    "valve_underlap": "spool lands shorter than the ports",
    "orifice_asymmetry": "supply-side edges have another gain than tank-side edges",
    "entrained_air": "free air in the oil: compliance that falls as pressure rises",
    "supply_droop": "supply pressure sags in proportion to the flow that is drawn",
    "input_delay": "transport delay of the command",
    "input_lag": "first-order lag of the input",
    "input_offset": "the input acts with an offset",
    "input_dead_zone": "near zero the input does nothing",
    "dry_friction": "Coulomb friction, perhaps larger near rest, where the simulation has none",
    "square_damping": "damping that grows with the square of speed",
    "direction_friction": "friction in proportion to speed that is larger in one direction",
    "constant_load": "constant force or torque",
    "hardening_spring": "force that grows with the cube of position, or of a deflection",
    "leak": "what is stored is lost in proportion to itself, by a way that the simulation has not",
    "end_cushion": "flow restriction near the stroke ends",
    "sensor_offset": "a sensor reads with an offset",
    "sensor_lag": "a sensor follows through a first-order lag",
    "sensor_saturation": "a sensor ends at an upper level",
    "sensor_offset_p_a": "pressure transducer A reads with an offset",
    "sensor_gain_p_a": "pressure transducer A reads with a gain error",
    "pump_ripple": "displacement ripple at a whole number of pulses a revolution",
    "motor_lag": "first-order lag of the pump speeds behind their commands",
    "displacement_loss": "displacement falls in proportion to pressure",
    "tooth_ripple": "error wave of one tooth pitch",
    "pulley_eccentricity": "error wave of one pulley turn",
    "guide_error": "error wave of another spatial period, from guides and Abbe offset",
    "inertial_stretch": "belt stretch in proportion to acceleration",
    "thermal_growth": "scale that grows with time",
    "scale_error": "error in proportion to position",
    "rate_dependent_band": "micro-slip band that widens with speed",
    "drift": "error that grows with time alone",
    "reversal_play": "backlash where the simulation has none",
    "drum_eccentricity": "error wave of one drum turn",
    "speed_slip": "slip per travel that grows with speed",
    "direction_slip": "extra slip per travel when moving backward",
    "acceleration_slip": "slip per travel that grows with acceleration",
    "cable_stretch": "stretch in proportion to acceleration times free length",
    "rest_relaxation": "elastic creep that is wound up by travel and relaxes in time",
}


def vocabulary() -> Mapping[str, Mapping[str, str]]:
    """Plant -> name -> meaning; "any" has what every recording may have."""
    names = {plant: {*rig.effects}.union(*rig.alike) for plant, rig in EVERY_RIG.items()}
    return {plant: {name: MEANS[name] for name in sorted(found)} for plant, found in names.items()} | {"any": FAULTS}


def right(plant: str, claimed: str, concealed: str) -> bool:
    """Whether a claimed name says what is concealed, or what no recording of that plant tells from it."""
    return claimed == concealed or any({claimed, concealed} <= alike for alike in EVERY_RIG[plant].alike)
