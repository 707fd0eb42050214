"""do-mpc on a machine of control_any.py: reads what is asked as JSON, prints RMS, worst and microseconds by case.

The same equations, written in CasADi; discrete by four Runge-Kutta steps a sample. The change of the inputs is what it
plans, so that their rate has hard limits; limits of outputs are soft. It is given the true state, and does not know
the load.
"""

import json
import sys
import time
from pathlib import Path

import casadi as ca
import do_mpc
import numpy as np

STEPS, FINE = 4, 20  # of Runge and Kutta in a sample: as predicted, as simulated
TOLERANCE, SMOOTH, PENALTY = 1e-2, 1e-4, 1e4


def cart(x, u, p):
    return [x[1], (p["k_f"] * u[0] - p["b"] * x[1] - p["dry"] * ca.tanh(x[1] / 0.01)) / p["mass"]]


def shaft(x, p):
    return p["k"] * (x[0] - x[2]) + p["d"] * (x[1] - x[3])


def two_masses(x, u, p):
    return [x[1], (u[0] - shaft(x, p) - p["b"] * x[1]) / p["j_m"], x[3], (shaft(x, p) - p["b"] * x[3]) / p["j_l"]]


def tanks(x, u, p):
    between = p["c_12"] * (x[0] - x[1]) / ca.sqrt(ca.fabs(x[0] - x[1]) + 0.001)
    h = [ca.fmax(x[i], 1e-6) for i in range(2)]
    rates = u[0] - between - p["c_1"] * ca.sqrt(h[0]), u[1] + between - p["c_2"] * ca.sqrt(h[1])
    return [r / p["area"] for r in rates]


PLANTS = {  # rates, place of each signal among the states
    "cart": (cart, {"x": 0}),
    "two_masses": (two_masses, {"phi_l": 2}),
    "tanks": (tanks, {"h_1": 0, "h_2": 1}),
}


def stepped(rates, x, u, p, period, steps):
    h = period / steps
    for _ in range(steps):
        k1 = ca.vertcat(*rates(x, u, p))
        k2 = ca.vertcat(*rates(x + h / 2 * k1, u, p))
        k3 = ca.vertcat(*rates(x + h / 2 * k2, u, p))
        k4 = ca.vertcat(*rates(x + h * k3, u, p))
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return x


def controller(asked, rates, place):
    n, m, tracked = len(asked["start"]), len(asked["low"]), asked["tracked"]
    scale = (np.array(asked["high"]) - np.array(asked["low"])) / 2
    model = do_mpc.model.Model("discrete")
    x, before = model.set_variable("_x", "x", (n, 1)), model.set_variable("_x", "before", (m, 1))
    change = model.set_variable("_u", "change", (m, 1))
    wanted = model.set_variable("_tvp", "wanted", (len(tracked), 1))
    acting = before + change
    model.set_rhs(
        "x", stepped(rates, x, [acting[i] * scale[i] for i in range(m)], asked["told"], asked["period"], STEPS)
    )
    model.set_rhs("before", acting)
    model.setup()
    mpc = do_mpc.controller.MPC(model)
    mpc.set_param(n_horizon=asked["horizon"], t_step=asked["period"], store_full_solution=False,
                  nlpsol_opts={"ipopt.print_level": 0, "print_time": 0, "ipopt.sb": "yes"})  # fmt: skip
    off = sum(
        ((x[place[name]] - wanted[i]) / (TOLERANCE * size)) ** 2
        for i, (name, size) in enumerate(zip(tracked, asked["sizes"], strict=True))
    )
    mpc.set_objective(mterm=off, lterm=off)
    mpc.set_rterm(change=SMOOTH)
    rate = np.minimum(np.array(asked["rate"]) / scale, 2.0)[:, None]
    mpc.bounds["lower", "_u", "change"], mpc.bounds["upper", "_u", "change"] = -rate, rate
    mpc.bounds["lower", "_x", "before"] = (np.array(asked["low"]) / scale)[:, None]
    mpc.bounds["upper", "_x", "before"] = (np.array(asked["high"]) / scale)[:, None]
    for name, (low, high) in asked["bounds"].items():
        value = shaft(x, asked["told"]) if name == "t_s" else x[place[name]]
        size = (high - low) / 2
        mpc.set_nl_cons(f"{name}_high", value / size, ub=high / size, soft_constraint=True, penalty_term_cons=PENALTY)
        mpc.set_nl_cons(f"{name}_low", -value / size, ub=-low / size, soft_constraint=True, penalty_term_cons=PENALTY)
    template, now = mpc.get_tvp_template(), {"k": 0}
    reference = np.array(asked["reference"])

    def ahead(_):
        for i in range(asked["horizon"] + 1):
            template["_tvp", i] = reference[min(now["k"] + i, len(reference) - 1)]
        return template

    mpc.set_tvp_fun(ahead)
    mpc.setup()
    return mpc, now, scale


def driven(asked, case, rates, place):
    mpc, now, scale = controller(asked, rates, place)
    n, m = len(asked["start"]), len(asked["low"])
    x_, u_ = ca.SX.sym("x", n), ca.SX.sym("u", m)
    plant = ca.Function("plant", [x_, u_], [stepped(rates, x_, u_, case["values"], asked["period"], FINE)])
    state, before, errors, seconds = np.array(asked["start"]), np.zeros(m), [], []
    mpc.x0 = np.append(state, before)
    mpc.set_initial_guess()
    for k, wanted in enumerate(asked["reference"]):
        errors.append([state[place[name]] - r for name, r in zip(asked["tracked"], wanted, strict=True)])
        now["k"], began = k, time.perf_counter()
        before = before + mpc.make_step(np.append(state, before)[:, None]).ravel()
        seconds.append(time.perf_counter() - began)
        acts = before * scale * case["share"][k] + np.array(case["load"][k])
        state = plant(state, acts).full().ravel()
    errors = np.array(errors)
    return {
        "errors": {name: {"rms": float(np.sqrt(np.mean(e**2))), "worst": float(np.abs(e).max())}
                   for name, e in zip(asked["tracked"], errors.T, strict=True)},
        "microseconds": 1e6 * float(np.median(seconds)),
    }  # fmt: skip


def main() -> None:
    asked = json.loads(Path(sys.argv[1]).read_text())
    rates, place = PLANTS[asked["plant"]]
    print(json.dumps({case: driven(asked, told, rates, place) for case, told in asked["cases"].items()}))


if __name__ == "__main__":
    main()
