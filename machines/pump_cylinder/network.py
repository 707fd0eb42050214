"""The structured recurrent network (SRNN) for the pressures of a pump-controlled cylinder (thesis 6.3.2).

    P_A(k) = P_A(k-1) + G_A divider( q_a - v,  gamma)     q_a = Network Qa(n_1, n_2, P_A(k-1), P_A(k-1) - P_B(k-1))
    P_B(k) = P_B(k-1) + G_B divider(-q_b + v, -gamma)     q_b = Network Qb(n_2,      P_B(k-1), P_B(k-1) - P_A(k-1))

The flow networks are linear, as in the thesis. Their leakage has two parts, a chamber's `own` and that `across` to the
other one. If both only drain (`leakage_bounds`) and the divider rises with its first input, the largest difference of
two runs with the same inputs shrinks in every step, so no pressure error can build up, whatever training finds.
"""

from collections.abc import Mapping

from greygate.machines.valve_cylinder.network import pressure
from greygate.models.adaptation import frozen
from greygate.models.network import Layer, Network, Port

LEAST, MOST = 0.2, 10.0  # of the leakage that a network starts with: what its own may become


def pump_srnn(
    k: Mapping[str, float],
    divider: Network,
    speeds: tuple[Port, Port],
    position: Port,
    known: str = "",
    sample_time: float = 1e-3,
    taps: int = 4,
    stretch: float = 5.0,
) -> Network:
    """Join linear flow networks and dividers into the SRNN of fig. 6.3, with the parameters `k` of table 6.1 (SI).

    k: also `q_max` [m^3/s] and `p_max` [Pa], by which flows and pressures are normalised, and `p_a_rest`, `p_b_rest`.
    divider: it is not trained. speeds: of pumps 1 and 2, rev/s; the network reads the mean of two samples of each.
    taps: backward differences of position from which the piston's speed is computed. stretch: see `cylinder.pressure`.
    known: `"a"` or `"b"`, a chamber with a sensor (figs. 6.5, 6.6); then only the other chamber is predicted.
    Inputs `speeds`, `position`, and of a known chamber `p_a_measured` or `p_b_measured`; outputs `p_a`, `p_b` [Pa].
    """
    p_max, q_max = k["p_max"], k["q_max"]
    predicted = [c for c in "ab" if c != known]
    sources = {c: f"p{c}" if c in predicted else f"p_{c}_measured" for c in "ab"}
    sensors = [Port(sources[c], "Pa", p_max, initial=k[f"p_{c}_rest"]) for c in "ab" if c == known]
    ports = [*speeds, position, *sensors], [Port(f"p_{c}", "Pa", p_max) for c in predicted]
    network = Network("pump_srnn", *ports, dt=sample_time)
    network.add("velocity", Layer({"now": [[1.0]], "before": [[-1.0]]}, [0.0], frozen={"now", "before", "bias"}))
    network.connect(position.name, "velocity.now")
    network.connect(position.name, "velocity.before", delay=1)
    for c in predicted:
        g = k["bulk_modulus"] * q_max * sample_time / (k[f"v_{c}0"] * p_max)
        network.add(f"p{c}", pressure(frozen(divider), g, k[f"p_{c}_rest"] / p_max, stretch))
    for c in predicted:
        other, sign = "ba"["ab".index(c)], 1.0 if c == "a" else -1.0
        pumps = {"1": speeds[0], "2": speeds[1]} if c == "a" else {"2": speeds[1]}
        own = k["c_i"] + 2 * k["c_ea"] if c == "a" else k["c_eb"]
        pumped = {n: sign * k[f"displacement_{n}"] * port.scale / q_max for n, port in pumps.items()}
        weights = {f"n{n}_z{d}": [[0.5 * w]] for n, w in pumped.items() for d in (0, 1)}
        weights |= {"own": [[-own * p_max / q_max]], "across": [[-k["c_i"] * p_max / q_max]]}
        network.add(f"q{c}", Layer(weights, [0.0]))
        network.add(f"d{c}", Layer({"own": [[1.0]], "other": [[-1.0]]}, [0.0], frozen={"own", "other", "bias"}))
        network.add(f"speed_{c}", Layer({f"d{n}": [[float(n == 0)]] for n in range(taps)}, [0.0], frozen={"bias"}))
        displaced = sign * k[f"area_{c}"] * position.scale
        network.add(f"gamma_{c}", Layer({"x": [[displaced / k[f"v_{c}0"]]]}, [0.0], frozen={"bias"}))
        for n, port in pumps.items():
            for d in (0, 1):
                network.connect(port.name, f"q{c}.n{n}_z{d}", delay=d)
        network.connect(sources[c], f"d{c}.own", delay=1)
        network.connect(sources[other], f"d{c}.other", delay=1)
        network.connect(sources[c], f"q{c}.own", delay=1)
        network.connect(f"d{c}", f"q{c}.across")
        for tap in range(taps):
            network.connect("velocity", f"speed_{c}.d{tap}", delay=tap)
        network.connect(position.name, f"gamma_{c}.x")
        network.connect(f"q{c}", f"p{c}.omega")
        network.connect(f"speed_{c}", f"p{c}.omega", gain=-displaced / (q_max * sample_time))
        network.connect(f"gamma_{c}", f"p{c}.gamma")
        network.connect(f"p{c}", f"p_{c}")
    return network.check()


def leakage_bounds(network: Network) -> dict[str, tuple[float, float]]:
    """Bounds for `train`, from a `pump_srnn` as it was joined: both leakages of a chamber always drain it."""
    w = {name: float(v[0, 0]) for name, v in network.parameters().items() if name.endswith((".own", ".across"))}
    least = {".own": LEAST, ".across": 0.0}
    return {
        f"q{c}{end}": (MOST * w[f"q{c}{end}"], part * w[f"q{c}{end}"])
        for c in "ab"
        for end, part in least.items()
        if f"q{c}{end}" in w
    }
