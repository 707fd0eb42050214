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
from greygate.plants.plant import Definition, Equation, Parameter, Plant, State, read_entries

HERE = Path(__file__).parent
RIG = Plant.read(HERE / "valve_hydraulic.toml")
OWN, SUPPLIED = (read_entries(HERE / "simulated" / f"{name}.toml") for name in ("valve_cylinder", "supply"))
CYLINDER = {symbol: p for symbol, p in RIG.parameters.items() if symbol != "dry"} | OWN["parameters"]
"""Thesis table 5.1."""
SUPPLY = SUPPLIED["parameters"]
"""Thesis tables A.1 to A.3."""


def valve_cylinder(supply: str = "full", **values: float) -> Plant:
    """The plant of thesis section 5.2: inputs `v_c` (V) and `f_ext` (N), outputs `x`, `p_a`, `p_b`, `p_s`, `u`, `v`.

    supply: `"full"` (appendix A) or `"constant"` (`p_s = p_supply`).
    values: parameters other than in `CYLINDER`, and with the full supply `SUPPLY`.

    It starts at rest at the centre with `p_a = p_b = p_s / 2`, the full supply in its steady state for `values`.

    Raises InputError for an unknown supply or parameter.
    """
    if supply not in ("full", "constant"):
        raise InputError(f"valve_cylinder: supply {supply!r}; give 'full' or 'constant'")
    plant = Plant(
        "valve_cylinder",
        CYLINDER,
        OWN["inputs"],
        {symbol: replace(state, start=None) for symbol, state in RIG.states.items()},
        RIG.equations | OWN["equations"],
        tuple(OWN["outputs"]),
        OWN["definitions"],
    )
    if supply == "full":
        plant = _with_full_supply(plant, values)
    return plant.with_parameters(**values)


def _with_full_supply(plant: Plant, values: dict[str, float]) -> Plant:
    known = {symbol: parameter.value for symbol, parameter in {**plant.parameters, **SUPPLY}.items()} | values
    line = Line(density=known["density"], bulk_modulus=known["bulk_modulus"])
    steady = _steady_supply(known)
    modes, states, equations, pressure, flow = _line(line, steady["p_pump"])
    chamber = State("Pa", steady["p_pump"] / 2, low=0.0)
    resting = {symbol: replace(state, initial=steady.get(symbol, 0.0)) for symbol, state in SUPPLIED["states"].items()}
    lined = {"supply": Definition("p_s", "Pa", pressure), "line_inflow": Definition("q_line", "m^3/s", flow)}
    return Plant(
        plant.name,
        {**plant.parameters, **SUPPLY, **modes},
        plant.inputs,
        {**plant.states, "p_a": chamber, "p_b": chamber, **resting, **states},
        {**plant.equations, **SUPPLIED["equations"], **equations},
        plant.outputs,
        {**plant.definitions, **lined, **SUPPLIED["definitions"]},
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
            "p_control": p,
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
