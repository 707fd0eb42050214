"""The structured recurrent network (SRNN) for the pressures of a valve-controlled cylinder (thesis 5.3.2).

    P_A(k) = P_A(k-1) + G2 divider( G1 q_a - v,  gamma)      q_a = Network Qa(u, P_A(k-1))
    P_B(k) = P_B(k-1) + G2 divider(-G1 q_b + v, -gamma)      q_b = Network Qb(u, P_B(k-1))

Its inputs are those of the thesis: the valve voltage and the position. The velocity is the backward difference of the
position, and `u` is the spool position *averaged over the sampling interval*, by a third-order difference equation.
"""

from collections.abc import Mapping

import numpy as np

from greygate.models.network import Layer, Network, Port

X_STEP = 5e-6  # m, the linear scale
X_SCALE = X_STEP * 2**14  # m; a step of the scale is an exact binary fraction
V_SCALE = 1.5  # V
V_STEP = 2 * V_SCALE / 2**12  # V, the 12-bit converter
VOLTAGE = Port("v_c", "V", V_SCALE, resolution=V_STEP)
POSITION = Port("x", "m", X_SCALE, resolution=X_STEP)


def driven_spool(
    a: np.ndarray, b: np.ndarray, c: np.ndarray, d: float, u_max: float, scale: float = V_SCALE
) -> Network:
    """u(k) = sum_n a_n u(k-n) + b_n v_c(k-n): the spool position, normalised (5.12): at the sample, or its mean.

    a (3, 3), b (3,), c (3,), d: exact discretisation s(k) = a s(k-1) + b v_c(k-1), u(k) = c s(k-1) + d v_c(k-1).
    scale: V, of the port that brings `v_c`.
    """
    denominator = np.poly(a)
    numerator = np.poly(a - np.outer(b, c)) + (d - 1) * denominator
    order = len(a)
    taps = {f"v{n}": [[numerator[n - 1] * scale / u_max]] for n in range(1, order + 2)}
    own = {f"u{n}": [[-denominator[n]]] for n in range(1, order + 1)}
    network = Network("spool", [Port("v_c")], [Port("u")])
    network.add("mean", Layer(taps | own, [0.0], frozen={*taps, *own, "bias"}))
    for port in taps:
        network.connect("v_c", f"mean.{port}", delay=int(port[1:]))
    for port in own:
        network.connect("mean", f"mean.{port}", delay=int(port[1:]))
    network.connect("mean", "u")
    return network


def measured_spool() -> Network:
    """u(k) of a valve whose spool is measured: the mean of its readings at (k-1)T and kT.

    The scale of the port that brings them is the full stroke.
    """
    network = Network("spool", [Port("u_measured")], [Port("u")])
    network.add("mean", Layer({"now": [[0.5]], "before": [[0.5]]}, [0.0], frozen={"now", "before", "bias"}))
    network.connect("u_measured", "mean.now")
    network.connect("u_measured", "mean.before", delay=1)
    network.connect("mean", "u")
    return network


def pressure(divider: Network, g2: float, initial: float, stretch: float) -> Network:
    """`Network Pa` (fig. 5.5): P(k) = P(k-1) + G2 divider(omega, gamma), all normalised.

    A quotient is linear in omega, so the divider is given `stretch * omega` and its answer is divided by `stretch`: it
    then works over its whole range [-1, 1] instead of near zero, and its errors and its rounding count for less.
    """
    network = Network("pressure", [Port("omega", scale=1 / stretch), Port("gamma")], [Port("p")])
    network.add("divider", divider)
    network.add(
        "state", Layer({"rate": [[g2 / stretch]], "p": [[1.0]]}, [0.0], initial=initial, frozen={"rate", "p", "bias"})
    )
    network.connect("omega", "divider.omega")
    network.connect("gamma", "divider.gamma")
    network.connect("divider", "state.rate")
    network.connect("state", "state.p", delay=1)
    network.connect("state", "p")
    return network


def valve_srnn(
    k: Mapping[str, float],
    flow: Network,
    divider: Network,
    spool: Network,
    drive: Port = VOLTAGE,
    position: Port = POSITION,
    sample_time: float = 1e-3,
    taps: int = 4,
    stretch: float = 8.0,
    leakage: tuple[Network, str, float, float] | None = None,
    oil: tuple[Port, Network, Network] | None = None,
) -> Network:
    """Join flow, divider and spool networks into the SRNN of fig. 5.4.

    k: parameters of the plant in SI units (`p_s`, `bulk_modulus`, `v_a0`, `v_b0`, `area_a`, `area_b`, `k_valve`,
    `u_max`, `q_max`) and `p_a_rest`, `p_b_rest`, the chambers' pressures before the first step.
    spool: network from `drive`, the signal of the valve, to the spool position: `driven_spool` or `measured_spool`.
    taps: backward differences of position from which the speed is computed. stretch: see `pressure`.
    leakage: (module from port `s` to `y`, reads, reach, size). If it reads "between", s is (p_a - p_b) / reach, and the
    flow size q_max y leaves chamber A and enters B; if "outward", it leaves each chamber, and s is its p / reach.
    oil: (port of the temperature, soft, leak), both networks from port `t` to `y`. The oil is soft's answer times as
    compressible as nominally, and leak's answer times (p_a - p_b) / p_s is a leakage from A to B over q_max.
    Inputs `drive` and `position` [m]; outputs `p_a`, `p_b` [Pa].
    """
    g1 = k["k_valve"] * k["u_max"] * np.sqrt(k["p_s"]) / k["q_max"]
    network = Network(
        "valve_srnn",
        [drive, position, *([oil[0]] if oil else [])],
        [Port("p_a", "Pa", k["p_s"]), Port("p_b", "Pa", k["p_s"])],
        dt=sample_time,
    )
    network.add("spool", spool)
    network.add("velocity", Layer({"now": [[1.0]], "before": [[-1.0]]}, [0.0], frozen={"now", "before", "bias"}))
    network.connect(drive.name, "spool")
    network.connect(position.name, "velocity.now")
    network.connect(position.name, "velocity.before", delay=1)
    for chamber, sign in (("a", 1.0), ("b", -1.0)):
        q, p = f"q{chamber}", f"p{chamber}"
        volume, displaced = k[f"v_{chamber}0"], k[f"area_{chamber}"] * position.scale
        g2 = k["bulk_modulus"] * k["q_max"] * sample_time / (volume * k["p_s"])
        network.add(q, flow)
        network.add(p, pressure(divider, g2, k[f"p_{chamber}_rest"] / k["p_s"], stretch))
        network.connect("spool", f"{q}.u", gain=sign)  # Qb is the mirror of Qa: q_b(u, p) = -q_a(-u, p)
        network.connect(p, f"{q}.p", delay=1)
        network.connect(q, f"{p}.omega", gain=g1)
        speed = f"speed_{chamber}"  # starts as the backward difference; training may lean on earlier ones too
        first = {f"d{n}": [[float(n == 0)]] for n in range(taps)}
        network.add(speed, Layer(first, [0.0], frozen={"bias"}))
        for n in range(taps):
            network.connect("velocity", f"{speed}.d{n}", delay=n)
        network.connect(speed, f"{p}.omega", gain=-sign * displaced / (k["q_max"] * sample_time))
        if not oil:
            network.connect(position.name, f"{p}.gamma", gain=sign * displaced / volume)
        network.connect(p, f"p_{chamber}")
    if leakage:
        _leak(network, *leakage, k["p_s"])
    if oil:
        _warm(network, *oil, position, k)
    return network.check()


def _product(network: Network, name: str) -> None:
    """Add the product of the ports `NAME.a` and `NAME.b`; it is 0 where one of them is, in the hardware too."""
    sums = {"a": [[1.0], [1.0]], "b": [[1.0], [-1.0]]}
    product = Network(name, [Port("a"), Port("b")], [Port("y")])
    product.add("squares", Layer(sums, np.zeros(2), "square", frozen={*sums, "bias"}))
    product.add("product", Layer({"squares": [[0.25, -0.25]]}, [0.0], frozen={"squares", "bias"}))
    for port in sums:
        product.connect(port, f"squares.{port}")
    product.connect("squares", "product.squares")
    product.connect("product", "y")
    network.add(name, product)


def _warm(network: Network, oil: Port, soft: Network, leak: Network, position: Port, k: Mapping[str, float]) -> None:
    """Let the temperature act on the stiffness of both chambers and on a leakage between them; see `valve_srnn`."""
    for name, module in (("soft", soft), ("leak", leak)):
        network.add(name, module)
        network.connect(oil.name, f"{name}.t")
    _product(network, "leaked")
    network.connect("leak", "leaked.a")
    for chamber, sign in (("a", 1.0), ("b", -1.0)):
        network.connect(f"p{chamber}", "leaked.b", delay=1, gain=sign)
        network.connect("leaked", f"p{chamber}.omega", gain=-sign)
        volume, stored = f"volume_{chamber}", f"stored_{chamber}"
        displaced = sign * k[f"area_{chamber}"] * position.scale / k[f"v_{chamber}0"]
        network.add(volume, Layer({"x": [[displaced]]}, [1.0], frozen={"x", "bias"}))
        network.connect(position.name, f"{volume}.x")
        _product(network, stored)
        network.connect(volume, f"{stored}.a")
        network.connect("soft", f"{stored}.b")
        network.add(f"gamma_{chamber}", Layer({"stored": [[1.0]]}, [-1.0], frozen={"stored", "bias"}))
        network.connect(stored, f"gamma_{chamber}.stored")
        network.connect(f"gamma_{chamber}", f"p{chamber}.gamma")


def _leak(network: Network, module: Network, reads: str, reach: float, size: float, p_s: float) -> None:
    """Join a leakage into the flow sums of both chambers; see `valve_srnn`."""
    for name, chambers in {"leak": "ab"}.items() if reads == "between" else {"leak_a": "a", "leak_b": "b"}.items():
        network.add(name, module)
        for chamber, sign in zip(chambers, (1.0, -1.0), strict=False):  # what leaves A enters B
            network.connect(f"p{chamber}", f"{name}.s", delay=1, gain=sign * p_s / reach)
            network.connect(name, f"p{chamber}.omega", gain=-sign * size)
