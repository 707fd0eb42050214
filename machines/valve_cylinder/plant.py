"""The servo-valve controlled cylinder of the thesis (section 5.2, table 5.1, appendix A), with its supply.

Symbols are those of the rigs (`k_valve`, `bulk_modulus`, `p_a`, ...). Signs: `q_a` and `q_b` flow into the chambers,
`f_ext` acts against extension. The supply is either complete (`supply="full"`: motor, pump, relief valve, accumulator,
line) or a constant pressure (`supply="constant"`).

It shares parameters, states, valve drive and friction with the rig's plant, valve_hydraulic.toml. It differs in the
physics that the networks of chapter 5 learn: one lap for all edges, leakage terms, an external force, 5 cm of stroke.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq

from greygate.errors import InputError
from greygate.machines.valve_cylinder.line import Line
from greygate.plants.plant import Definition, Equation, Parameter, Plant, State

RIG = Plant.read(Path(__file__).with_name("valve_hydraulic.toml"))
CYLINDER = {symbol: parameter for symbol, parameter in RIG.parameters.items() if symbol != "dry"} | {
    "x_max": Parameter(0.05, "m", meaning="stroke either side of the centre"),
    "c_internal": Parameter(0.0, "m^3/(Pa s)", meaning="leakage past the piston"),
    "c_external": Parameter(0.0, "m^3/(Pa s)", meaning="leakage of each chamber to tank"),
    "overlap": Parameter(0.0, "m", meaning="lap of all four edges: > 0 closed centre, < 0 open centre"),
    "q_max": Parameter(6e-5, "m^3/s", meaning="rated flow, by which networks are normalised"),
}
"""Thesis table 5.1."""

SUPPLY = {
    "voltage": Parameter(240.0, "V", meaning="motor supply"),
    "l_motor": Parameter(2.5e-3, "H", meaning="armature inductance"),
    "r_motor": Parameter(1.0, "ohm", meaning="armature resistance"),
    "k_emf": Parameter(0.2, "V s/rad", meaning="back-EMF constant"),
    "k_torque": Parameter(0.2, "N m/A", meaning="torque constant"),
    "gear": Parameter(7.0, "1", meaning="gearbox ratio"),
    "inertia": Parameter(1.2e-3, "kg m^2", meaning="motor and pump"),
    "k_fric": Parameter(4e-4, "N m s/rad", meaning="viscous friction of the shaft"),
    "displacement": Parameter(16e-6 / (2 * np.pi), "m^3/rad", meaning="pump, 16 cm^3/rev"),
    "eta_mech": Parameter(0.8, "1", meaning="mechanical efficiency of the pump"),
    "c_pump": Parameter(1e-13, "m^3/(Pa s)", meaning="pump leakage"),
    "v_pump": Parameter(2e-3, "m^3", meaning="volume at the pump outlet"),
    "m_relief": Parameter(0.1, "kg", meaning="relief spool"),
    "b_relief": Parameter(300.0, "N s/m", meaning="relief spool damping"),
    "k_relief": Parameter(1e4, "N/m", meaning="relief spring"),
    "f_relief": Parameter(2000.0, "N", meaning="relief spring preload"),
    "a_relief": Parameter(1e-4, "m^2", meaning="relief spool area"),
    "w_relief": Parameter(0.022, "m", meaning="relief port width"),
    "x_relief_max": Parameter(0.01, "m", meaning="relief spool stroke"),
    "v_control": Parameter(1e-5, "m^3", meaning="relief control chamber"),
    "a_restrictor": Parameter(5e-8, "m^2", meaning="restrictor of the control chamber"),
    "c_discharge": Parameter(0.7, "1", meaning="discharge coefficient of restrictor and port"),
    "density": Parameter(890.0, "kg/m^3", meaning="of the oil"),
    "p_gas0": Parameter(2e7, "Pa", meaning="accumulator precharge"),
    "v_gas0": Parameter(150e-6, "m^3", meaning="accumulator gas volume at precharge"),
    "polytropic": Parameter(1.4, "1", meaning="polytropic exponent of the gas"),
    "k_gas": Parameter(2e-10, "m^3/(Pa s)", meaning="accumulator inlet"),
}
"""Thesis tables A.1 to A.3."""


def valve_cylinder(supply: str = "full", **values: float) -> Plant:
    """The plant of thesis section 5.2: inputs `v_c` (V) and `f_ext` (N), outputs `x`, `p_a`, `p_b`, `p_s`, `u`, `v`.

    supply: `"full"` (appendix A) or `"constant"` (`p_s = p_supply`).
    values: parameters other than in `CYLINDER`, and with the full supply `SUPPLY`.

    It starts at rest at the centre with `p_a = p_b = p_s / 2`, the full supply in its steady state for `values`.
    Where (A.10) prints sign(p_c - P_s) for the restrictor, flow here runs from the higher pressure to the lower.

    Raises InputError for an unknown supply or parameter.
    """
    if supply not in ("full", "constant"):
        raise InputError(f"valve_cylinder: supply {supply!r}; give 'full' or 'constant'")
    plant = Plant(
        "valve_cylinder",
        CYLINDER,
        {"v_c": "V", "f_ext": "N"},
        {symbol: replace(state, start=None) for symbol, state in RIG.states.items()},
        {
            **RIG.equations,
            "motion": Equation(
                "v",
                {
                    "pressure": "(p_a - p_b) * area",
                    "viscous": "-viscous * v",
                    "spring": "-stiffness * x",
                    "friction": "-f_friction",
                    "external": "-f_ext",
                },
                storage="mass",
            ),
            "continuity_a": Equation(
                "p_a",
                {
                    "valve": "q_a",
                    "piston": "-area * v",
                    "internal_leakage": "-c_internal * (p_a - p_b)",
                    "external_leakage": "-c_external * (p_a - p_tank)",
                },
                storage="(v_a0 + area * x) / bulk_modulus",
            ),
            "continuity_b": Equation(
                "p_b",
                {
                    "valve": "q_b",
                    "piston": "area * v",
                    "internal_leakage": "c_internal * (p_a - p_b)",
                    "external_leakage": "-c_external * (p_b - p_tank)",
                },
                storage="(v_b0 - area * x) / bulk_modulus",
            ),
        },
        ("x", "p_a", "p_b", "p_s", "u", "v"),
        {
            "supply": RIG.definitions["supply"],
            "edge_sa": Definition("q_sa", "m^3/s", {"orifice": "k_valve * orifice(u - overlap, p_s, p_a)"}),
            "edge_at": Definition("q_at", "m^3/s", {"orifice": "k_valve * orifice(-u - overlap, p_a, p_tank)"}),
            "edge_sb": Definition("q_sb", "m^3/s", {"orifice": "k_valve * orifice(-u - overlap, p_s, p_b)"}),
            "edge_bt": Definition("q_bt", "m^3/s", {"orifice": "k_valve * orifice(u - overlap, p_b, p_tank)"}),
            "flow_a": Definition("q_a", "m^3/s", {"from_supply": "q_sa", "to_tank": "-q_at"}),
            "flow_b": Definition("q_b", "m^3/s", {"from_supply": "q_sb", "to_tank": "-q_bt"}),
            "flow_s": Definition("q_s", "m^3/s", {"to_a": "q_sa", "to_b": "q_sb"}),
            **{name: RIG.definitions[name] for name in ("stribeck", "slip", "friction")},
        },
    )
    if supply == "full":
        plant = _with_full_supply(plant, values)
    return plant.with_parameters(**values)


def _with_full_supply(plant: Plant, values: dict[str, float]) -> Plant:
    known = {symbol: parameter.value for symbol, parameter in {**plant.parameters, **SUPPLY}.items()} | values
    line = Line(density=known["density"], bulk_modulus=known["bulk_modulus"])
    steady = _steady_supply(known)
    modes, states, equations, pressure, flow = _line(line, steady["p_pump"])
    chamber = steady["p_pump"] / 2
    return Plant(
        plant.name,
        {**plant.parameters, **SUPPLY, **modes},
        plant.inputs,
        {
            **plant.states,
            "p_a": State("Pa", chamber, low=0.0),
            "p_b": State("Pa", chamber, low=0.0),
            "i_motor": State("A", steady["i_motor"]),
            "omega": State("rad/s", steady["omega"]),
            "p_pump": State("Pa", steady["p_pump"], low=0.0),
            "x_relief": State("m", steady["x_relief"], 0.0, "x_relief_max", rate="v_relief"),
            "v_relief": State("m/s"),
            "p_control": State("Pa", steady["p_pump"], low=0.0),
            "v_gas": State("m^3", steady["v_gas"]),
            **states,
        },
        {
            **plant.equations,
            "motor_current": Equation(
                "i_motor",
                {"supply": "voltage", "back_emf": "-k_emf * gear * omega", "resistance": "-r_motor * i_motor"},
                storage="l_motor",
            ),
            "motor_speed": Equation(
                "omega",
                {
                    "torque": "k_torque * gear * i_motor",
                    "friction": "-k_fric * omega",
                    "load": "-displacement * (p_pump - p_tank) / eta_mech",
                },
                storage="inertia",
            ),
            "pump_outlet": Equation(
                "p_pump",
                {
                    "pump": "displacement * omega",
                    "pump_leakage": "-c_pump * p_pump",
                    "line": "-q_line",
                    "relief": "-q_relief",
                    "relief_control": "-q_control",
                    "accumulator": "-q_gas",
                },
                storage="v_pump / bulk_modulus",
            ),
            "relief_position": Equation("x_relief", {"velocity": "v_relief"}),
            "relief_motion": Equation(
                "v_relief",
                {
                    "control_pressure": "a_relief * p_control",
                    "preload": "-f_relief",
                    "damping": "-b_relief * v_relief",
                    "spring": "-k_relief * x_relief",
                    "axial_flow_force": "-0.43 * w_relief * x_relief * (p_pump - p_tank)",
                },
                storage="m_relief",
            ),
            "relief_control": Equation(
                "p_control",
                {"restrictor": "q_control", "spool": "-a_relief * v_relief"},
                storage="(v_control + a_relief * x_relief) / bulk_modulus",
            ),
            "accumulator": Equation("v_gas", {"inflow": "-q_gas"}),
            **equations,
        },
        plant.outputs,
        {
            **plant.definitions,
            "supply": Definition("p_s", "Pa", pressure),
            "line_inflow": Definition("q_line", "m^3/s", flow),
            "relief_flow": Definition(
                "q_relief",
                "m^3/s",
                {"port": "c_discharge * sqrt(2 / density) * orifice(w_relief * x_relief, p_pump, p_tank)"},
            ),
            "restrictor": Definition(
                "q_control",
                "m^3/s",
                {"orifice": "c_discharge * sqrt(2 / density) * orifice(a_restrictor, p_pump, p_control)"},
            ),
            "gas": Definition("p_gas", "Pa", {"polytropic": "p_gas0 * (v_gas0 / v_gas)**polytropic"}),
            "accumulator_flow": Definition("q_gas", "m^3/s", {"inlet": "k_gas * (p_pump - p_gas)"}),
        },
    )


def _line(line: Line, pressure: float):
    """Parameters, states, equations and the terms of p_s and q_line of the fitted line (A.21).

    Each mode is driven twice, by the pump-side pressure and by the flow into the valve: `level` and `rate` obey
    level' = omega rate, rate' = omega (drive - level) - damping rate, so drive -> level is omega^2 / (s^2 + ...).
    """
    gains = line.fit()
    omegas = line.frequencies(len(gains["transmission"]))
    parameters = {"line_damping": Parameter(line.damping, "1/s", meaning="32 nu / d^2 of the supply line")}
    states, equations = {}, {}
    p_s: dict[str, str] = {}
    q_line: dict[str, str] = {}
    for n, omega in enumerate(omegas, start=1):
        parameters[f"line_omega_{n}"] = Parameter(omega, "rad/s", meaning=f"mode {n} of the supply line")
        for function, unit in (("transmission", "1"), ("impedance", "Pa s/m^3"), ("admittance", "m^3/(Pa s)")):
            for part, gain in zip("ab", gains[function][n - 1], strict=True):
                name = f"line_{function}_{part}{n}"
                parameters[name] = Parameter(gain, unit, meaning=f"mode {n}, fitted to the four-pole line")
        for side, drive, unit, level in (("p", "p_pump", "Pa", pressure), ("q", "q_s", "m^3/s", 0.0)):
            states[f"line_{side}{n}"] = State(unit, level)
            states[f"line_{side}{n}_rate"] = State(unit)
            equations[f"line_{side}{n}"] = Equation(
                f"line_{side}{n}", {"rate": f"line_omega_{n} * line_{side}{n}_rate"}
            )
            equations[f"line_{side}{n}_rate"] = Equation(
                f"line_{side}{n}_rate",
                {
                    "drive": f"line_omega_{n} * {drive}",
                    "level": f"-line_omega_{n} * line_{side}{n}",
                    "damping": f"-line_damping * line_{side}{n}_rate",
                },
            )
        for terms, name, function, sign, side in (
            (p_s, f"transmission_{n}", "transmission", "", "p"),
            (p_s, f"impedance_{n}", "impedance", "-", "q"),
            (q_line, f"admittance_{n}", "admittance", "", "p"),
            (q_line, f"transmission_{n}", "transmission", "", "q"),
        ):
            mode = f"line_{function}_a{n} * line_{side}{n}_rate + line_{function}_b{n} * line_{side}{n}"
            terms[name] = f"{sign}({mode})"
    return parameters, states, equations, p_s, q_line


def _steady_supply(k: dict[str, float]) -> dict[str, float]:
    """The supply at rest with the valve closed: relief spool open just enough for the pump's whole flow."""

    def at(p: float) -> dict[str, float]:
        i_torque = k["displacement"] * (p - k["p_tank"]) / k["eta_mech"]
        emf, torque = k["k_emf"] * k["gear"], k["k_torque"] * k["gear"]
        omega = (k["voltage"] * torque - i_torque * k["r_motor"]) / (emf * torque + k["r_motor"] * k["k_fric"])
        flow = k["displacement"] * omega - k["c_pump"] * p
        opening = k["c_discharge"] * k["w_relief"] * np.sqrt(2 / k["density"] * (p - k["p_tank"]))
        return {
            "p_pump": p,
            "i_motor": (k["voltage"] - emf * omega) / k["r_motor"],
            "omega": omega,
            "x_relief": flow / opening,
            "v_gas": k["v_gas0"] * (k["p_gas0"] / p) ** (1 / k["polytropic"]),
        }

    def force(p: float) -> float:
        stiffness = k["k_relief"] + 0.43 * k["w_relief"] * (p - k["p_tank"])
        return k["a_relief"] * p - k["f_relief"] - stiffness * at(p)["x_relief"]

    opening = k["f_relief"] / k["a_relief"]
    try:
        return at(brentq(force, opening, 2 * opening, xtol=1e-3, rtol=1e-15))
    except ValueError:
        raise InputError(
            "valve_cylinder: the full supply has no steady state with an open relief valve; check the supply's values"
        ) from None


SPOOL = 1  # the place of u in the state (i, u, u_dot) of `spool_discrete`


def spool_discrete(plant: Plant, sample_time: float = 1e-3) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Coil and spool (5.9, 5.10), exactly discretised for a held `v_c`: `A` (3, 3), `B` (3,), `C` (3,), `D` scalar.

    With s = (i, u, u_dot) and inside the saturations,

        s(k)    = A s(k-1) + B v_c(k-1)
        ubar(k) = C s(k-1) + D v_c(k-1)     the mean of u over [(k-1) T, k T]

    where v_c(k-1) is held over that interval.
    """
    k = {symbol: parameter.value for symbol, parameter in plant.parameters.items()}
    spring = k["omega_n"] ** 2
    continuous = np.zeros((5, 5))  # i, u, u_dot, integral of u, v_c
    continuous[0, [0, 4]] = -k["r_coil"] / k["l_coil"], 1 / k["l_coil"]
    continuous[1, 2] = 1.0
    continuous[2, :3] = spring * k["k_h"], -spring, -2 * k["zeta"] * k["omega_n"]
    continuous[3, 1] = 1.0
    step = expm(continuous * sample_time)
    return step[:3, :3], step[:3, 4], step[3, :3] / sample_time, step[3, 4] / sample_time
