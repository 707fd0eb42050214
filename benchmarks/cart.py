"""Makes recordings/cart: two runs of a cart whose dry friction its plant's file leaves out, for `make demo`."""

import numpy as np

from greygate.identify.study import ROOT
from greygate.plants.plant import Plant
from greygate.plants.recording import Recording
from greygate.plants.simulator import simulate

TAKES = "seconds"

FOLDER = ROOT / "recordings" / "cart"
STEP = 5e-3  # s
QUANTUM = 1e-5  # m, of the encoder
HELD = (20, 120)  # samples for which a voltage is held
RUNS = {"train": 4000, "test": 2000}  # samples


def main() -> None:
    """Write both runs."""
    real = Plant.read(FOLDER / "cart.toml").with_term("cart", "dry", "-6.0 * tanh(v / 0.003)")
    real = real.with_parameters(mass=2.06, k_f=5.3, b=24.0)
    rng = np.random.default_rng(44)
    for name, samples in RUNS.items():
        volts: list[float] = []
        while len(volts) < samples:
            volts += [round(rng.uniform(-8, 8), 2)] * int(rng.integers(*HELD))
        u = np.array(volts[:samples])
        x = simulate(real, {"u": u}, sample_time=STEP, step=real.step)["x"]
        seen = np.round(np.round(x / QUANTUM) * QUANTUM, 5)
        Recording(STEP, {"u": u, "x": seen}, {"u": "V", "x": "m"}).write_csv(FOLDER / f"{name}.csv")
