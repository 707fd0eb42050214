import numpy as np
import pytest

from greygate.machines.measured.crane import PRESSURE, VALVE, crane


def by_hand(network, u):
    """Pressures of the equations in the module's docstring, normalised inside."""
    p = {n: np.squeeze(v) for n, v in network.parameters().items()}
    s = pressure = speed = 0.0
    found = []
    for opening in u / VALVE.scale:
        s = p["spool.s"] * s + p["spool.u"] * opening + p["spool.bias"]
        orifice = np.tanh(p["orifice.spool"] * s + p["orifice.bias"])
        flow = p["flow.s"] * s + p["flow.orifice"] * orifice + p["flow.bias"]
        friction = np.tanh(p["friction.speed"] * speed + p["friction.bias"])
        pressure = p["pressure.p"] * pressure + p["pressure.flow"] * flow + p["pressure.v"] * speed + p["pressure.bias"]
        speed = p["speed.v"] * speed + p["speed.p"] * pressure + p["speed.friction"] * friction + p["speed.bias"]
        found.append(PRESSURE.scale * pressure)
    return np.array(found)


@pytest.mark.parametrize("delay", [1, 4])
def test_the_crane_is_the_equations_written_by_hand(delay):
    u = np.random.default_rng(0).normal(size=200)
    network = crane(1, 1, delay, seed=2)
    answer = np.ravel(network.run({VALVE.name: u})[PRESSURE.name])
    np.testing.assert_allclose(answer, by_hand(network, np.r_[np.zeros(delay), u[:-delay]]), rtol=0, atol=1e-12)


def test_without_losses_the_oscillation_stays():
    network = crane(0, 0).with_parameters({"pressure.p": [[1.0]], "speed.v": [[1.0]]})
    answer = np.ravel(network.run({VALVE.name: np.r_[1.0, np.zeros(20_000)]})[PRESSURE.name])
    early, late = (np.ptp(answer[k : k + 200]) for k in (100, 19_800))
    assert late == pytest.approx(early, rel=1e-2)
