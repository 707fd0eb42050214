"""What engineers write for a unit: its factor and zero by hand, or a refusal that names the readings."""

from math import pi

import numpy as np
import pytest
from sweeping import every

from greygate.errors import InputError
from greygate.plants.readers.read import read_recording
from greygate.plants.units.quantities import quantity
from greygate.plants.units.reading import READINGS, SPELT, _read, converted, split

POUND, OUNCE, PSI = 4.4482216152605, 4.4482216152605 / 16, 6894.757293168361  # N, N, Pa
KILOPOND, MERCURY, WATER = 9.80665, 133.322387415, 9.80665  # N, Pa of 1 mm, Pa of 1 mm
GALLON, BRITISH = 3.785411784e-3, 4.54609e-3  # m^3

TAKEN = [  # unit of the recording, factor, spellings; a blank in a spelling is written _
    ("K", 1, "K kelvin Kelvin °K degK deg_K Δ°C delta_K delta_degC"),
    ("1", 1, "- -- — none None 1 unitless dimensionless ratio bool Bool boolean flag enum state index"),
    ("1", 0.01, "% percent pct Pct Prozent %RH %_RH %rH"), ("1", 1e-3, "‰ permille mV/V mm/m"),
    ("1", 1e-6, "ppm µm/m ustrain µstrain µε microstrain"), ("1", 1e-9, "ppb"), ("1", 1, "V/V m/m N/N ticks tick"),
    ("count", 1, "count counts Counts cnt cts raw inc incr increments pulses LSB digits steps"),
    ("tick/s", 1, "tick/s ticks/s"), ("1/rad", 1 / (2 * pi), "counts/rev inc/rev"),
    # angles and turning
    ("rad", 1, "rad RAD radian radians"), ("rad", 1e-3, "mrad"), ("rad", 1e-6, "µrad urad"),
    ("rad", pi / 180, "deg Deg DEG deg. degs degree degrees Degrees ° º"), ("rad", pi / 200, "gon gradian"),
    ("rad", pi / 180e3, "mdeg"), ("rad", pi / 10800, "arcmin"), ("rad", pi / 648000, "arcsec"),
    ("rad", 2 * pi, "rev revs turn turns revolutions"), ("rad/s", 1, "rad/s rad/sec rads/s rads/sec rad_s^-1 rad_s-1"),
    ("rad/s", pi / 30, "rpm RPM Rpm r.p.m. r/min rev/min revs/min U/min Upm Umdr/min 1/min min-1 min^-1 min⁻¹ tr/min"),
    ("rad/s", 100 * pi / 3, "krpm"), ("rev/s", 1, "rev/s revs/s rev/sec U/s turns/s"),
    ("rad/s", pi / 180, "dps DPS deg/s deg/sec °/s degrees/s degree/s deg_s-1 degrees_per_second"),
    ("rad/s", pi / 180e3, "mdps"), ("rad/s", pi / 10800, "deg/min"), ("rad/s^2", 1, "rad/s^2 rad/s2 rad/s² rad/s/s"),
    ("rad/s^2", pi / 180, "deg/s^2 deg/s² °/s² deg/s/s"), ("rad/s^2", pi / 30, "rpm/s"),
    # time and frequency
    ("s", 1, "s sec Sec SEC secs sec. second seconds Seconds"), ("s", 1e-3, "ms msec milliseconds"),
    ("s", 1e-6, "us µs μs usec µsec microseconds"), ("s", 1e-9, "ns nsec"), ("s", 60, "min mins minute minutes"),
    ("s", 3600, "hr hrs hour hours"), ("s", 86400, "day days"), ("Hz", 1, "Hz HZ hz hertz 1/s s-1 s^-1 s⁻¹ /s"),
    ("Hz", 1e3, "kHz khz KHz KHZ 1/ms"), ("Hz", 1e6, "MHz Mhz"), ("Hz", 1e-3, "mHz"), ("Hz", 1, "counts/s pulses/s"),
    # lengths and motion
    ("m", 1, "m meter metre meters Meters METERS"), ("m", 0.1, "dm"), ("m", 0.01, "cm CM"),
    ("m", 1e-3, "mm millimeter"),
    ("m", 1e-6, "um µm μm UM micrometers"), ("m", 1e3, "km KM Km"), ("m", 0.0254, "in inch inches Inch in."),
    ("m", 2.54e-5, "thou"), ("m", 0.3048, "ft foot feet ft."), ("m", 0.9144, "yd"), ("m", 1609.344, "mi mile miles"),
    ("m", 1852, "nmi"), ("m^2", 1, "m2 m^2 m²"), ("m^2", 1e-4, "cm2 cm² cm^2"), ("m^2", 1e-6, "mm2 mm² mm^2 mm**2"),
    ("m^2", 0.0254**2, "in2 in^2 in²"), ("m^3", 1e-3, "L liter litre liters Liter dm3 dm³"), ("m^3", 1e-9, "mm3 mm³"),
    ("m^3", 1e-6, "ml mL cc CC cm3 cm^3 cm³"), ("m^3", 0.0254**3, "in3 in^3"),
    ("m/s", 1, "m/s m/sec m_s-1 m·s⁻¹ m*s^-1 mps meters/second meters_per_second"), ("m/s", 1e-3, "mm/s mm/sec"),
    ("m/s", 1e-2, "cm/s"), ("m/s", 1 / 60, "m/min"), ("m/s", 1e-3 / 60, "mm/min"), ("m/s", 0.3048 / 60, "fpm ft/min"),
    ("m/s", 1 / 3.6, "km/h km/hr kph KPH kmh kmph Km/h KM/H"), ("m/s", 0.44704, "mph MPH mile/h"),
    ("m/s", 0.0254, "ips in/s inch/s"), ("m/s", 0.3048, "ft/s ft/sec"), ("m/s", 1852 / 3600, "knot knots kts KTS"),
    ("m/s^2", 1, "m/s^2 m/s2 m/s² m/s/s m/sec^2 m/sec² m_s-2 m.s-2 m·s⁻² m/(s^2) m/s**2"), ("m/s^2", 1e-3, "mm/s²"),
    ("m/s^2", 9.80665, "gn g_0 g0 gee"), ("m/s^3", 1, "m/s^3 m/s³"), ("m/rad", 1e-3 / (2 * pi), "mm/rev mm/U"),
    # mass, force, torque
    ("kg", 1, "kg Kg KG kgs kilogram kilograms"), ("kg", 1e-3, "gram grams gramme"), ("kg", 1e-6, "milligram"),
    ("kg", 1e3, "tonne tonnes"), ("kg", 0.45359237, "lbm"), ("kg", POUND / 0.3048, "slug"),
    ("N", 1, "N newton Newton newtons"), ("N", 1e3, "kN kilonewton"), ("N", 1e6, "MN"), ("N", 1e-3, "mN"),
    ("N", 10, "daN"), ("N", 0.01, "cN"), ("N", POUND, "lbf LBF Lbf"), ("N", OUNCE, "ozf"),
    ("N", 1e3 * POUND, "kip klbf"),
    ("N", KILOPOND, "kgf KGF kp"), ("N", KILOPOND / 1e3, "gf"), ("N", 1e-5, "dyn"),
    ("N m", 1, "Nm N_m N.m N-m N*m N·m N⋅m Newton_meter newton_meters m_N m.N"), ("N m", 1e3, "kNm KNm kN_m kN.m kN-m"),
    ("N m", 1e-3, "mNm mN_m Nmm N_mm N-mm N.mm"), ("N m", 0.01, "Ncm N_cm N-cm cNm"), ("N m", 1e-6, "µNm"),
    ("N m", 0.0254 * POUND, "in-lb in-lbs in_lb in.lb in*lb inlb in-lbf lb-in lbf-in lbf_in lb.in lbin in.-lb"),
    ("N m", 0.3048 * POUND, "ft-lb ft-lbs ft_lb ft.lb ft.lbs ft._lbs ftlb ft-lbf lb-ft lbft lb.ft lbf*ft lbf_ft "
    "ft*lbf"),
    ("N m", 0.0254 * OUNCE, "oz-in ozin oz_in oz.in ozf-in in-oz"),
    ("N m", KILOPOND, "kgf_m kgfm kgf-m kgf*m kpm kp_m"),
    ("N m", KILOPOND / 100, "kgf_cm kgfcm kgf-cm kgf.cm"), ("kg m^2", 1, "kgm2 kgm² kg_m2 kg·m² kg-m2 kg_m^2 kg*m**2"),
    ("kg m^2", 1e-4, "kgcm2 kgcm² kg_cm²"), ("kg m^2", 1e-7, "gcm2 gcm² g_cm²"),
    ("N m/rad", 1, "Nm/rad N_m/rad N.m/rad"),
    ("N m/rad", 180 / pi, "Nm/deg Nm/°"), ("N m s/rad", 1, "Nms/rad Nm/(rad/s) N_m_s/rad N.m.s/rad"),
    ("N m/A", 1, "Nm/A N_m/A"), ("Wb", 1, "Vs V_s Wb V/Hz"),
    ("N/m", 1, "N/m"), ("N/m", 1e3, "N/mm"), ("N/m", 1e6, "kN/mm"),
    ("N s/m", 1, "N_s/m Ns/m N/(m/s) N*s/m"), ("N s", 1, "Ns N_s N-s"), ("kg/m^3", 1, "kg/m3 kg/m³"),
    ("kg/m^3", 1e3, "g/cm3 g/cm³ g/ml kg/L"), ("kg/s", 1, "kg/s"), ("kg/s", 1 / 3600, "kg/h kg/hr"),
    ("kg/s", 0.45359237 / 3600, "lb/hr lb/h"), ("kg/s", 1 / 3.6, "t/h"),
    # pressure
    ("Pa", 1, "Pa pascal Pascal N/m2 N/m² N/m^2 Pa(a) Pa_abs"),
    ("Pa", 1e3, "kPa kpa KPa KPA kilopascal kPaa kPa_abs kPa(a)"),
    ("Pa", 1e6, "MPa Mpa N/mm2 N/mm² N/mm^2 MPa(abs) MN/m²"),
    ("Pa", 100, "hPa hpa mbar MBAR mBar mbar(a) mbara hPa_abs"),
    ("Pa", 1e9, "GPa Gpa"), ("Pa", 1e4, "N/cm2 N/cm²"), ("Pa", 1e-3, "mPa"),
    ("bar", 1, "bar Bar BAR bara BARA bar_a bar(a) bar_(a) bar(abs) bar_abs bar_abs. bar_absolute bar-a bard bar_diff"),
    ("Pa", PSI, "psi PSI Psi psia PSIA psi_a psi(a) psi_abs psid lbf/in2 lbf/in^2 lbf/in² lb/in2 lb/in²"),
    ("Pa", 1e3 * PSI, "ksi kpsi"), ("Pa", POUND / 0.3048**2, "psf"), ("Pa", 101325, "atm atma"),
    ("Pa", 98066.5, "at ata kgf/cm2 kgf/cm² kp/cm2 kp/cm² kg/cm2_abs"), ("Pa", 101325 / 760, "torr Torr"),
    ("Pa", MERCURY, "mmHg mm_Hg"), ("Pa", 25.4 * MERCURY, "inHg in_Hg in.Hg"), ("Pa", WATER, "mmH2O mmWS mm_H2O"),
    ("Pa", 10 * WATER, "cmH2O"), ("Pa", 25.4 * WATER, "inH2O inWC in_H2O in._H2O"), ("Pa", 1e3 * WATER, "mH2O mWS mWC"),
    ("Pa/s", 1e5, "bar/s"), ("Pa s", 1e-3, "cP mPas mPa_s mPa·s"), ("Pa s", 1, "Pas Pa_s Pa·s"),
    ("m^2/s", 1e-6, "cSt cst mm2/s mm²/s"),
    # flow
    ("m^3/s", 1, "m3/s m³/s m^3/s m³/sec"), ("m^3/s", 1 / 3600, "m3/h m³/h m³/hr m^3/h"), ("m^3/s", 1 / 60, "m³/min"),
    ("m^3/s", 1e-3 / 60, "l/min L/min lpm LPM Lpm l/MIN liters/min litres_per_minute dm³/min"),
    ("m^3/s", 1e-3, "l/s L/s lps"),
    ("m^3/s", 1e-3 / 3600, "l/h L/h lph"), ("m^3/s", 1e-6 / 60, "ml/min mL/min cc/min cm3/min cm³/min"),
    ("m^3/s", 1e-6, "ml/s cc/s cm3/s cm³/s"), ("m^3/s", 0.3048**3 / 60, "cfm CFM ft3/min acfm"),
    ("m^3/s", 0.3048**3, "cfs"),
    ("m^3/s", GALLON / 60, "USgpm US_gpm usgpm"), ("m^3/s", BRITISH / 60, "igpm"),
    ("m^3/rad", 1e-6 / (2 * pi), "cc/rev cm3/rev cm³/rev cm³/U ml/rev"),
    # electricity, energy, power
    ("V", 1, "V volt Volt volts Volts VDC Vdc V_DC"), ("V", 1e-3, "mV mVDC millivolts"), ("V", 1e3, "kV KV"),
    ("V", 1e-6, "uV µV"), ("A", 1, "A amp Amp amps Amps ampere Ampere A_DC"), ("A", 1e-3, "mA mADC milliamps"),
    ("A", 1e-6, "uA µA"), ("A", 1e3, "kA"), ("ohm", 1, "ohm Ohm ohms Ohms Ω Ω"), ("ohm", 1e3, "kOhm kohm kΩ"),
    ("ohm", 1e-3, "mOhm mΩ"), ("ohm", 1e6, "MΩ"), ("farad", 1e-6, "uF µF"), ("farad", 1e-9, "nF"),
    ("farad", 1e-12, "pF"),
    ("henry", 1e-3, "mH"), ("henry", 1e-6, "uH µH"), ("coulomb", 1, "As A_s coulomb"), ("coulomb", 3600, "Ah A_h"),
    ("coulomb", 3.6, "mAh"), ("T", 1, "T tesla Tesla"), ("T", 1e-3, "mT"), ("T", 1e-6, "uT µT"),
    ("T", 1e-4, "gauss Gauss"),
    ("W", 1, "W watt Watts J/s"), ("W", 1e3, "kW KW kw Kw"), ("W", 1e6, "MW"), ("W", 1e-3, "mW"),
    ("W", 735.49875, "PS"),
    ("J", 1, "J joule Joules Ws W_s"), ("J", 1e3, "kJ KJ"), ("J", 3.6e6, "kWh KWh kW_h"), ("J", 3600, "Wh"),
    ("V s/rad", 1, "V/(rad/s) V_s/rad"), ("V s/rad", 30 / pi, "V/rpm"), ("V s/rad", 0.03 / pi, "V/krpm"),
    ("V s/m", 1, "V/(m/s)"), ("K/s", 1, "K/s °C/s degC/s deg_C/s"), ("K/s", 1 / 60, "K/min °C/min"),
    ("W/K", 1, "W/K W/°C"),
    ("W/(m^2 K)", 1, "W/(m²·K) W/(m2_K) W/m²/K"), ("J/(kg K)", 1e3, "kJ/(kg_K) kJ/kg/K"), ("siemens/m", 1e-4, "uS/cm"),
]  # fmt: skip
TEMPERATURES = {  # zero and one of it in K
    (
        273.15,
        1.0,
    ): "degC °C ºC ˚C ℃ deg_C Deg_C Deg.C deg._C DegC DEGC degc °c °_C degrees_C degree_C degrees_Celsius celsius "
    "Celsius Grad_C Grad_Celsius C° oC centigrade",
    (273.15, 1e-3): "mdegC m°C",
    (273.15 - 160 / 9, 5 / 9): "degF °F ℉ deg_F Deg.F degrees_F fahrenheit Fahrenheit",
}
CASES = [(text, unit, one, 0.0) for unit, one, texts in TAKEN for text in texts.split()]
CASES += [(text, "K", one, zero) for (zero, one), texts in TEMPERATURES.items() for text in texts.split()]

GAUGE = (
    "barg BARG bar_g bar(g) bar_(g) Bar(g) bar-g bar_rel mbar_rel mbarg kPag kPa_g kPa(g) Pa_(gauge) psig PSIG psi_g "
)
GAUGE += "psi(g) bar_gauge barü bar_ü atü bar_relative MPa(rel.) kg/cm2g kg/cm²(g) Pag mmHg_g inH2O_g"
REFUSED = {  # what the message says: spellings
    "gauge pressure": GAUGE,
    "coulomb or degree Celsius; write coulomb or degC": "C", "farad or degree Fahrenheit": "F", "kelvin or": "k",
    "gram or the acceleration of free fall; write gram or g_0": "g", "gauss or the acc": "G Gs",
    "per metre and kelvin or per": "W/mK kW/mK W/(mK)", "a viscosity or of": "kg/ms",
    "a milligram or a thousandth of free fall": "mg", "milligauss or": "mG", "write gram/s or g_0/s": "g/s",
    "ohm or degree Rankine": "R", "an hour or": "h", "a day or": "d D", "a ton or a time": "t", "a litre or": "l",
    "henry or an hour": "H", "siemens or a second": "S", "millisiemens or a millisecond": "mS", "ampere or a year": "a",
    "bar or a": "b B", "molar or": "M", "volt or": "v", "write N": "n", "degree Celsius or the speed": "c",
    "charge or": "e",
    "pascal or petaampere": "PA", "pascal or picoampere": "pa", "milliampere or megaampere": "MA ma",
    "millivolt or megavolt": "MV mv", "a millisecond or megasecond": "MS Ms", "milliwatt or megawatt": "mw Mw",
    "millimetre or megametre": "MM Mm", "megapascal or millipascal": "MPA mpa", "megahertz or millihertz": "mhz MHZ",
    "millilitre or": "ML", "nanometre or newton metre": "nm", "newton metre or a nautical mile": "NM",
    "a kilonewton or knot": "kn KN", "knot or a kiloton": "kt KT",
    "thousandth of an inch or an angular mil": "mil mils",
    "inch or a second of arc": '"', "a foot or a minute of arc": "'", "degree in German or a gradian": "grad Grad",
    "revolutions a second or radians a second; write rev/s or rad/s": "rps RPS r/s",
    "radians or radians a second": "rads",
    "cycles a second or counts a second": "cps", "feet a second or frames": "fps FPS",
    "metre a second or one": "ms-1 ms^-1",
    "force or a pound of mass": "lb lbs LBS pounds", "ounce of force or": "oz",
    "of force on an area or of mass": "kg/cm2 kg/cm²",
    "a torque or mass times length": "kg_m kgm kg-cm kgcm kg.m", "metric horsepower": "hp HP", "Pferdest": "ps",
    "US gallons a minute or imp": "gpm GPM gal/min", "a US gallon or": "gal gallons", "of gravity": "Gal",
    "litres a minute or litres a metre": "l/m", "cubic centimetres a minute": "ccm",
    "thousand or parts in a trillion": "ppt",
    "a short ton": "ton tons", "a count or of information": "bit bits", "converter": "ADC", "apparent power": "VA",
    "not applicable or not available": "n/a N/A", "arbitrary or an astronomical": "au a.u. AU",
    "a grain": "gr", "a gram metre": "gm", "full|range": "%FS %_FS %_F.S. %_of_full_scale p.u. pu",
    "over turns a minute or over 1/min": "mV/min-1 mV/min⁻¹ V/(1/min) Nm/(min-1)",
    "logarithm": "dB dBm dBA dB(A) pH",
    "standard state": "slpm SLPM sccm scfm SCFM Nl/min NL/min Nm3/h Nm³/h Nm^3 nlpm",
    "oscillation": "Vrms Vpp VAC Arms Vpk A_rms mVpp",
    "write parentheses": "N/m_s N/m/s V/rad/s Nm/rad/s W/m2_K J/kg_K",
    "write kN/m or knot/m": "KN/m", "write W/coulomb or W/degC": "W/C", "in other letters it is": "NMM",
    "is not known": "foo m% V% %V ‰_m 0.1_bar x10_rpm g/√Hz barrel mol/ m^99 "
    "m^0 ^2 / () (m m) m//s __import__('os') 1e3 2 kiloohmm °X sqrt(m) m^1.5 ?",
    "longer than any": "m*m*m*m*m*m*m*m*m*m*m*m*m*m*m*m*m*m*m*m*m*m*m*m",
    "a quantity without a unit here": "mol/L cd m^7",
}  # fmt: skip


def test_a_unit_that_engineers_write_has_its_factor_and_zero():
    def check(text, unit, one, zero):
        values, to = converted(np.array([0.0, 1.0]), text.replace("_", " ") if text != "g_0" else text, "x")
        assert to == unit
        assert values[0] == pytest.approx(zero, rel=1e-14)
        assert values[1] - values[0] == pytest.approx(one, rel=1e-9 if zero else 1e-14)  # a difference of two near 273

    every(CASES, check)


@pytest.mark.parametrize("says", REFUSED)
def test_a_unit_of_two_readings_or_none_is_refused_with_what_it_may_be(says):
    def check(text):
        with pytest.raises(InputError, match=f"(?i){says}") as refused:
            converted(np.array([0.0, 1.0]), text.replace("_", " ") if "__" not in text else text, "x")
        assert "\n" not in str(refused.value)

    every(REFUSED[says].split(), check)


def test_every_spelling_and_every_reading_is_a_unit_and_what_a_message_says_to_write_is_taken_as_that():
    assert len(CASES) > 600
    assert all(quantity(unit) for unit in SPELT.values())
    units = {part.partition(": ")[0] for text in READINGS.values() for part in text.split("; ")} - {"?"}
    assert all(quantity(_read(unit)) == quantity(unit) for unit in units)


WANTED = [  # as written, what the plant has, what 1 becomes; None: both readings fit, or none
    ("C", "K", 274.15), ("C", "degC", 1.0), ("g", "m/s^2", 9.80665), ("g", "kg", 1e-3), ("mg", "m/s^2", 9.80665e-3),
    ("g/s", "kg/s", 1e-3), ("h", "s", 3600.0), ("PA", "Pa", 1.0), ("MA", "A", None), ("MPA", "Pa", None), ("kn",
    "N", 1e3),
    ("nm", "N m", 1.0), ("rps", "rad/s", None), ("rps", "rev/s", None), ("mil", "m", 2.54e-5), ("lb", "N", POUND),
    ("kg cm", "N m", KILOPOND / 100), ("hp", "W", None), ("gpm", "m^3/s", None), ("VA", "W", None), ("mS", "s", 1e-3),
    ("barg", "barg", 1.0), ("barg", "bar", None), ("°C", "K", 274.15), ("K", "°C", -272.15), ("degF", "degC", -155 / 9),
    ("bar", "Pa", 1e5), ("rpm", "Hz", None), ("Hz", "rad/s", None), ("1/s", "rad/s", None), ("rpm", "rev/s", 1 / 60),
    ("rad", "1", 1.0), ("rev", "1", None), ("rad/s", "1/s", None), ("Nm", "J", 1.0), ("Nm", "N m/rad", None),
    ("cc/rev", "m^3", None), ("counts", "1", 1.0), ("C", "C", 1.0), ("V", "A", None), ("ms", "furlong", None),
]  # fmt: skip


def test_what_a_plant_declares_settles_a_unit_only_if_one_reading_fits():
    def check(text, wanted, one):
        if one is None:
            with pytest.raises(InputError):
                converted(np.ones(1), text, "x", wanted)
        else:
            values, unit = converted(np.ones(1), text, "x", wanted)
            assert (values[0], unit) == (pytest.approx(one, rel=1e-12), wanted)

    every(WANTED, check)


def test_units_are_read_from_every_form_of_header_and_from_a_row_below(tmp_path):
    for header, name in (
        ("T [deg C]", "T"),
        ("T (deg C)", "T"),
        ("T / deg C", "T"),
        ("T, deg C", "T"),
        ("T_degC", "T"),
    ):
        assert read_recording({"t": [0.0, 1.0], header: [0.0, 1.0]})[name].tolist() == [273.15, 274.15]
    for header in ("p [bar a]", "p (bar a)", "p [bar(a)]", "p (bar(a))", "p_bara", "p [bar (abs)]"):
        found = read_recording({"t": [0.0, 1.0], header: [0.0, 1.0]})
        assert (found["p"].tolist(), found.units["p"]) == ([0.0, 1.0], "bar")
    for header in ("p [bar g]", "p (bar(g))", "p_barg", "p_psig", "p / bar g"):
        with pytest.raises(InputError, match="gauge pressure"):
            read_recording({"t": [0.0, 1.0], header: [0.0, 1.0]})
    for header in ("p_bar_a", "p bar(a)"):
        with pytest.raises(InputError):
            read_recording({"t": [0.0, 1.0], header: [0.0, 1.0]})
    for below, told in (("bar(a)", None), ("[bar(a)]", None), ("Pa (gauge)", "gauge"), ("(bar(g))", "gauge")):
        (tmp_path / "row.csv").write_text(f"time,p\ns,{below}\n0,1\n1,2\n")
        if told is None:
            assert read_recording(tmp_path / "row.csv").units == {"p": "bar"}
        else:
            with pytest.raises(InputError, match=told):
                read_recording(tmp_path / "row.csv")
    assert split("slope_m/s²", "x") == ("slope", "m/s²")


@pytest.mark.parametrize(
    ("header", "read"),
    [
        ("p_A [bar]", ("p_A", "bar")), ("x_1 [mm]", ("x_1", "mm")), ("eta_1 (%)", ("eta_1", "%")),
        ("x_1 [1]", ("x_1", "1")), ("x_1 [-]", ("x_1", "-")), ("p_a_Pa [Pa]", ("p_a", "Pa")),
        ("u_V [V]", ("u", "V")), ("u_V [mV]", None), ("p_Pa [bar]", None),
    ],
)  # fmt: skip
def test_a_sign_that_numbers_channels_is_no_second_unit(header, read):
    if read is None:
        with pytest.raises(InputError, match="names two units"):
            split(header, "a.csv")
    else:
        assert split(header, "a.csv") == read


def test_a_force_before_a_length_is_asked_after_and_is_no_name(tmp_path):
    path = tmp_path / "a.csv"
    for suffix in ("N_m", "kN_m", "N_mm"):
        rows = f"t_s,x_{suffix},y_m\n0,1,1\n1,2,3\n"
        path.write_text(rows)
        for given in (path, {"t": [0.0, 1.0], f"x_{suffix}": [0.0, 1.0]}):
            with pytest.raises(InputError, match=r"write x \[k?N mm?\], x \[k?N/mm?\] or x_k?N \[mm?\]"):
                read_recording(given)
    assert split("x_N_m [N/m]", "a.csv") == ("x_N_m", "N/m")
    assert split("N_m", "a.csv") == ("N", "m")
    assert split("share_ppm", "a.csv") == ("share", "ppm")
