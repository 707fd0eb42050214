"""What engineers write for a unit: in headers of LabVIEW, Simulink, CANape, dSPACE, of controllers, robots and loggers.

Letters count: mW is no MW. What is a product of the symbols in `plants/quantities.py` is not repeated here.
"""

import re

_NONE = (
    "", "-", "--", "---", "–", "—", "none", "None", "NONE", "unitless", "Unitless", "dimensionless", "ratio", "bool",
    "Bool", "BOOL", "boolean", "Boolean", "flag", "enum", "Enum", "ENUM", "state", "logical", "index",
)  # fmt: skip
_RPM = (
    "1/min", "1 / min", "/min", "min-1", "min^-1", "r/min", "R/min", "r.p.m", "U/min", "U/Min", "Upm", "UPM",
    "Umdr/min", "Umin^-1", "tr/min", "giri/min", "ob/min",
)  # fmt: skip
_LPM = ("lpm", "LPM", "Lpm", "l/Min", "L/Min", "l/MIN", "L/MIN")
_PSI = ("PSI", "Psi", "psid", "PSID", "lb/in^2", "lbs/in^2", "lb/in2", "lbs/in2")
_KMH = ("km/h", "km/H", "Km/h", "KM/H", "kph", "KPH", "kmh", "kmph", "KMH")
_PER_TURN = {
    "mm": "mm",
    "cc": "cc",
    "cm^3": "cc",
    "cm3": "cc",
    "ml": "mL",
    "mL": "mL",
    "in^3": "inch^3",
    "in3": "inch^3",
}
_TORQUE = (("lbf", ("lb", "lbs", "lbf"), "inch"), ("lbf", ("lb", "lbs", "lbf"), "ft"), ("ozf", ("oz", "ozf"), "inch"))
_LENGTH = {"inch": ("in", "inch"), "ft": ("ft",)}
_SIGNS = ("", " ", "-", ".", "*")

SPELT = {
    **dict.fromkeys(_NONE, "1"), **dict.fromkeys(_RPM, "rpm"), **dict.fromkeys(_LPM, "L/min"),
    **dict.fromkeys(_PSI, "psi"), **dict.fromkeys(_KMH, "km/hour"),
    "U/s": "rev/s", "Umdr/s": "rev/s", "tr/s": "rev/s", "/s": "Hz", "deg/s/s": "deg/s^2", "DPS": "dps",
    "rads/s": "rad/s", "rads/sec": "rad/s",
    "hz": "Hz", "HZ": "Hz", "khz": "kHz", "Khz": "kHz", "KHz": "kHz", "KHZ": "kHz", "Mhz": "MHz",
    "kpa": "kPa", "Kpa": "kPa", "KPa": "kPa", "KPA": "kPa", "hpa": "hPa", "HPA": "hPa", "Mpa": "MPa",
    "MBAR": "mbar", "mBar": "mbar", "KW": "kW", "kw": "kW", "Kw": "kW", "KV": "kV", "kv": "kV", "KA": "kA", "KJ": "kJ",
    "KWh": "kWh", "KWH": "kWh", "kwh": "kWh", "KG": "kg", "Kg": "kg", "kgs": "kg", "Gpa": "GPa", "UM": "um",
    "KM": "km", "Km": "km", "CM": "cm",
    "KNm": "kN m", "kohm": "kohm", "KOhm": "kohm", "Kohm": "kohm", "degK": "K", "C°": "degC", "oC": "degC",
    "Cel": "degC", "GradC": "degC", "Prozent": "percent", "per cent": "percent", "% RH": "percent", "%RH": "percent",
    "%rH": "percent", "% rH": "percent", "%rh": "percent", "%r.F": "percent", "% r.F": "percent", "ue": "ustrain",
    "uε": "ustrain", "mps": "m/s", "MPS": "m/s", "mps2": "m/s^2", "mps^2": "m/s^2", "mph": "mile/hour",
    "MPH": "mile/hour", "kts": "knot", "KTS": "knot", "ips": "inch/s", "ipm": "inch/min", "fpm": "ft/min",
    "lph": "L/hour", "LPH": "L/hour", "lps": "L/s", "LPS": "L/s", "CC": "cc", "cfm": "ft^3/min", "CFM": "ft^3/min",
    "acfm": "ft^3/min", "cfs": "ft^3/s", "USgpm": "usgal/min", "usgpm": "usgal/min", "USGPM": "usgal/min",
    "US gpm": "usgal/min", "US gal/min": "usgal/min", "igpm": "ukgal/min", "imp gal/min": "ukgal/min",
    "in.Hg": "inHg", "in Hg": "inHg", "mm Hg": "mmHg", "in H2O": "inH2O", "in.H2O": "inH2O", "mm H2O": "mmH2O",
    "cm H2O": "cmH2O", "in WC": "inH2O", "m WS": "mH2O", "mm WS": "mmH2O", "cst": "cSt", "CST": "cSt", "CP": "cP",
    "kgm^2": "kg m^2", "kgm2": "kg m^2", "kgcm^2": "kg cm^2", "kgcm2": "kg cm^2", "kgmm^2": "kg mm^2",
    "gcm^2": "gram cm^2", "gcm2": "gram cm^2", "g cm^2": "gram cm^2", "g*cm^2": "gram cm^2", "g/cm^3": "gram/cm^3",
    "g/cm3": "gram/cm^3", "g/cc": "gram/cc", "g/ml": "gram/mL", "g/mL": "gram/mL", "g/l": "gram/L", "g/L": "gram/L",
    "g/m^3": "gram/m^3", "g/m3": "gram/m^3", "g/kWh": "gram/(kW hour)", "g/kg": "gram/kg", "lb/h": "lbm/hour",
    "lb/hr": "lbm/hour", "lbs/hr": "lbm/hour", "lb/min": "lbm/min", "lb/ft^3": "lbm/ft^3", "lb/ft3": "lbm/ft^3",
    "mS/cm": "msiemens/cm", "uS/cm": "usiemens/cm", "S/m": "siemens/m", "Adc": "A", "A DC": "A", "A dc": "A",
    **{f"{top}/{turn}": f"{unit}/rev" for top, unit in _PER_TURN.items() for turn in ("U", "r", "tr")},
    **{f"{unit}{kind}": unit for unit in ("V", "mV", "kV", "mA") for kind in ("DC", "dc", " DC", " dc")},
    **{f"{delta}{sign}{unit}": "K" for delta in ("delta", "Delta", "Δ") for sign in ("", " ", "_")
       for unit in ("degC", "K", "°C")},
    **{f"{a}{sign}{b}": f"{force} {length}" for force, forces, length in _TORQUE for sign in _SIGNS
       for one in forces for two in _LENGTH[length] for a, b in ((one, two), (two, one))},
}  # fmt: skip
"""A whole unit as `quantities.plain` has it -> the unit in the symbols there."""

_FREE, _FALL = "gram", "g_0: the acceleration of free fall"
_TURNS = "rev/s: revolutions a second; rad/s: radians a second"
_HORSE = "PS: the metric horsepower of 735.5 W; bhp: the imperial one of 745.7 W"
_GALLONS = "usgal/min: US gallons a minute; ukgal/min: imperial gallons a minute"
_GALLON = "usgal: a US gallon; ukgal: an imperial gallon"
_POUND = "lbf: a pound of force; lbm: a pound of mass"
_OUNCE = "ozf: an ounce of force; ozm: an ounce of mass"
_KILO = "kgf/{0}: kilograms of force on an area; kilogram/{0}: of mass on an area"
_MIL = "thou: a thousandth of an inch; mrad: an angular mil, of which there are four"
_GRAD = "deg: a degree in German; gon: a gradian"
_TON = "tonne: a tonne of 1000 kg; shton: a short ton"
_ANY = "1: not applicable; ?: not available"
_SCALE = "1: arbitrary; ?: an astronomical unit"
_KNOT = "kN: a kilonewton; knot"
_RADS = "rad: radians; rad/s: radians a second"

READINGS = {
    "C": "coulomb; degC: degree Celsius", "c": "degC: degree Celsius; ?: the speed of light",
    "mC": "mcoulomb: a millicoulomb; mdegC: a thousandth of a degree Celsius", "f": "degF: degree Fahrenheit; ?: femto",
    "F": "farad; degF: degree Fahrenheit", "R": "ohm; Rankine: degree Rankine",
    "k": "K: kelvin; ?: a thousand",
    "g": f"{_FREE}; {_FALL}", "mg": "mgram: a milligram; mg_0: a thousandth of free fall",
    "ug": "ugram: a microgram; ug_0: a millionth of free fall", "G": f"gauss; {_FALL}", "Gs": f"gauss; {_FALL}",
    "mG": "mGs: milligauss; mg_0: a thousandth of free fall", "kG": "kGs: kilogauss; kg: a kilogram",
    "gr": f"{_FREE}; grain: a grain; gon: a gradian", "gm": f"{_FREE}; gram m: a gram metre",
    "H": "henry; hour: an hour", "h": "hour: an hour; ?: Planck's constant", "d": "day: a day; ?: a tenth",
    "D": "day: a day; ?: a dioptre", "t": "tonne: a ton; ?: a time", "l": "L: a litre; ?: a length",
    "M": "?: molar; ?: a million", "MIN": "min: minutes; ?: a minimum", "Min": "min: minutes; ?: a minimum",
    "S": "siemens; s: a second", "mS": "msiemens: millisiemens; ms: a millisecond",
    "uS": "usiemens: microsiemens; us: a microsecond", "nS": "nsiemens: nanosiemens; ns: a nanosecond",
    "MS": "ms: a millisecond; megasecond; msiemens: millisiemens",
    "Ms": "ms: a millisecond; megasecond",
    "NS": "ns: a nanosecond; N s: a newton second", "US": "us: a microsecond; usiemens: microsiemens",
    "cs": "cSt: centistokes; centisecond", "cS": "cSt: centistokes; centisecond",
    "St": "cm^2/s: stokes; ?: pieces in German", "a": "A: ampere; year: a year", "u": "?: a millionth; ?: a mass",
    "b": "bar; ?: a bit", "B": "bar; ?: a byte", "e": "?: a charge; ?: a number", "v": "V: volt; ?: a speed",
    "n": "N: newton; ?: a number", "w": "W: watt; ?: a work", "p": "Pa: pascal; ?: a power",
    "P": "dPa s: poise; ?: a power",
    "PA": "Pa: pascal; petaampere", "pa": "Pa: pascal; pA: picoampere", "MA": "mA: milliampere; megaampere",
    "ma": "mA: milliampere; megaampere", "MV": "mV: millivolt; megavolt", "mv": "mV: millivolt; megavolt",
    "mw": "mW: milliwatt; MW: megawatt", "Mw": "mW: milliwatt; MW: megawatt", "Mm": "mm: millimetre; megametre",
    "MM": "mm: millimetre; megametre; ?: a million", "MG": "mgram: a milligram; Mgram: a megagram; MGs: megagauss",
    "ML": "mL: a millilitre; megalitre", "Ml": "mL: a millilitre; megalitre",
    "MPA": "MPa: megapascal; mPa: millipascal", "mpa": "MPa: megapascal; mPa: millipascal",
    "MHZ": "MHz: megahertz; mHz: millihertz", "mhz": "MHz: megahertz; mHz: millihertz",
    "MT": "mT: millitesla; megatesla; ?: a megatonne", "mt": "mT: millitesla; tonne: a metric tonne",
    "MH": "mhenry: millihenry; Mhenry: megahenry", "MF": "mfarad: millifarad; Mfarad: megafarad",
    **{f"{w}/{below}": f"{w}/(m K): per metre and kelvin; {w}/millikelvin: per thousandth of a kelvin"
       for w in ("W", "mW", "kW") for below in ("mK", "(mK)")},
    **{f"kg/{below}": "kg/(m s): of a viscosity; kg/millisecond: of a flow" for below in ("ms", "(ms)")},
    "nm": "nanometre; N m: newton metre", "NM": "N m: newton metre; nmi: a nautical mile",
    "kt": "knot; ?: a kiloton", "KT": "knot; ?: a kiloton",
    **dict.fromkeys(("kn", "KN", "Kn"), _KNOT), **dict.fromkeys(("mil", "mils"), _MIL),
    **dict.fromkeys(("grad", "Grad", "GRAD"), _GRAD), **dict.fromkeys(("rps", "RPS", "r/s"), _TURNS),
    **dict.fromkeys(("rads", "Rads", "RADS"), _RADS), **dict.fromkeys(("hp", "HP", "Hp"), _HORSE),
    **dict.fromkeys(("lb", "lbs", "LB", "LBS", "pound", "pounds"), _POUND), **dict.fromkeys(("oz", "OZ"), _OUNCE),
    **dict.fromkeys(("gpm", "GPM", "gal/min"), _GALLONS), **dict.fromkeys(("gal", "gallon", "gallons"), _GALLON),
    **dict.fromkeys(("ton", "tons"), _TON), **dict.fromkeys(("au", "AU", "a.u", "a.u.", "arb"), _SCALE),
    **dict.fromkeys(("n/a", "N/A", "n.a", "NA", "na"), _ANY),
    **{f"{kg}/{area}": _KILO.format(area) for kg in ("kg", "Kg", "KG") for area in ("cm^2", "cm2", "mm^2", "mm2")},
    **{f"kg{sign}{m}": f"kgf {m}: a torque; kilogram {m}: mass times length" for sign in _SIGNS
       for m in ("m", "cm", "mm")},
    '"': "inch; arcsec: a second of arc", "''": "inch; arcsec: a second of arc",
    "'": "ft: a foot; arcmin: a minute of arc", "Gal": f"cm/s^2: of gravity; {_GALLON}",
    "ps": "picosecond; PS: Pferdestärke",
    "cps": "Hz: cycles a second; count/s: counts a second; cP: centipoise",
    "CPS": "Hz: cycles a second; count/s: counts a second; cP: centipoise",
    "fps": "ft/s: feet a second; Hz: frames a second", "FPS": "ft/s: feet a second; Hz: frames a second",
    "bps": "Hz: bits a second; ?: basis points", "spm": "count/min: strokes a minute; count/min: samples a minute",
    **{f"ms{sign}1": "m/s: a metre a second; kHz: one a millisecond" for sign in ("-", "^-")},
    **{f"ms{sign}2": "m/s^2: a metre a second squared; 1/ms^2: one a millisecond squared" for sign in ("-", "^-")},
    "l/m": "L/min: litres a minute; L/metre: litres a metre", "L/m": "L/min: litres a minute; L/metre: litres a metre",
    "rev/m": "rpm: revolutions a minute; rev/metre: revolutions a metre", "#": "lbf: a pound; count: a number",
    "klb": "klbf: a thousand pounds of force; klbm: of mass", "ksc": "at: kilograms of force on a cm^2; ?: another",
    "ccm": "cc: cubic centimetres; cc/min: cubic centimetres a minute",
    "ppt": "permille: parts in a thousand; trillionth: parts in a trillion", "bit": "count: a count; ?: of information",
    "bits": "count: a count; ?: of information", "ADC": "A: a direct current; count: a converter's count",
    "VA": "W: as watts; W: an apparent power, which is another", "°R": "Rankine; ?: Réaumur",
}  # fmt: skip
"""A factor, or a whole unit -> what it may be, each with its meaning; ? has no unit here."""
ALONE = frozenset({"h", "d", "t", "l"})  # of `READINGS`: in a product they are the unit

_RANGE = "a part of a range that is not told; multiply by it, or write percent or 1"
_LOGARITHM = "a logarithm of a ratio; convert it to the quantity itself"
_PER_RPM = "over turns a minute or over 1/min, of which 2 pi lie between; write rpm below the slash, or min above it"
_STANDARD = "a volume at a standard state, so a mass; convert it to kg/s, or to m^3/s as it flows"
_SIZE = "the size of an oscillation, not a value at each time; write V or A if it is meant so"
ADVICE = (
    (
        re.compile(r"%\s*(?:of\s+)?(?:F\.?\s?S\.?|FSO|FSR|full scale|span|max|v\.?E\.?)|p\.?\s?u\.?|per unit", re.I),
        _RANGE,
    ),
    (re.compile(r".+/\s*(?:min\^?-1|\((?:1/min|min\^?-1)\))"), _PER_RPM),
    (re.compile(r"dB\w*|dB\s*\(\w*\)|Np|neper|pH|bel", re.I), _LOGARITHM),
    (
        re.compile(
            r"(?:std|st|s|n)\s?(?:l|ltr)(?:/min|/h|/s|pm|m)|scc?cm|sccm|scf[mh]|[ns]m\^?3(?:/\w+)?|m\^?3n(?:/\w+)?|ln/\w+",
            re.I,
        ),
        _STANDARD,
    ),
    (re.compile(r"[mkuM]?[VA][\s_]?(?:rms|RMS|pp|PP|p-p|pk-pk|pk|p|peak|eff|ac|AC)"), _SIZE),
)
"""What is no unit of a value at a time, and what to do about it."""
PRESSURE = re.compile(
    r"(?P<base>..+?)(?:\s*[([_\s-]\s*(?P<apart>absolute|absolut|abs|a|gauge|gage|ga|g|relative|relativ|rel|ü|ue|"
    r"differential|diff|d)\.?\s*[)\]]?|(?P<joined>abs|a|g|d|ü))",
    re.I,
)
"""A pressure and what it counts from: bar(a), psig, kPa abs, mbar rel."""
GAUGE = "grüu"  # what begins so counts from the ambient pressure
TEMPERATURE = re.compile(
    r"(?<![^\W\d_])(?P<milli>m|milli)?(?:deg(?:ree)?s?|°)[\s._]{0,2}(?P<of>c(?:elsius)?|f(?:ahrenheit)?|k(?:elvin)?)(?![^\W\d_])"
    r"|(?<![^\W\d_])(?:grad\s)(?P<grad>c)(?![^\W\d_])|(?<![^\W\d_])(?:grad\s)?(?P<word>celsius|fahrenheit|centigrade)(?![^\W\d_])",
    re.I,
)
"""deg C, °c, degrees_F, Grad Celsius, also within a product."""
