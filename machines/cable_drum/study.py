"""The cable-drum sensor (thesis chapter 7) on its simulated rig: the SNN, and the black boxes it is compared with."""

from functools import lru_cache
from itertools import product
from statistics import median
from time import monotonic

import numpy as np

from greygate.machines.cable_drum.network import ERROR, FASTEST, cable_drum
from greygate.machines.cable_drum.plant import SAMPLE_TIME, STEP, record
from greygate.models.accuracy import float_error, rmse
from greygate.models.families.blocks import nguyen_widrow
from greygate.models.families.regression import nfir, noe
from greygate.models.network import Network, Port
from greygate.models.training.levenberg import train
from greygate.models.training.objective import Objective
from greygate.models.training.record import Record
from greygate.plants.recording import Recording
from greygate.progress import Progress, silent

POSITION = Port("x_pe", "m", 2**16 * STEP, resolution=STEP)
TRIPS = ("trips_50", "trips_100", "trips_140")
TRAINING = ("training", *TRIPS)
SCENARIOS = (*TRAINING, "validation", "home")
THESIS = {  # um RMS: tables 7.1 to 7.3, NOE #10
    "fnn": (600, 572, 654, 576, 520, 506, 592, 569, 495),
    "narx": (10.5, 10.5, 10.6, 10.7, 10.7, 10.6, 10.6, 10.5, 9.5),
    "noe": (47.0, 42.2, 30.2, 50.6, 39.4, 39.2, 53.1, 38.6, 31.1),
    "noe_10": 16.6,
}
VALIDATED = {"validation": 77.0, "home": 29.0}  # um RMS, section 7.5
ARCHITECTURES = tuple((taps, neurons) for taps in (1, 2, 3) for neurons in (10, 20, 30))  # 1 to 9 of the tables
SIZES, SEEDS = (5, 10, 20), range(4)
EPOCHS, DECAY = 60, 1e-5
HELD = 3000  # samples: a minute at rest


@lru_cache
def records(**rig: float) -> dict[str, Record]:
    """Records: training, the round trips, validation without the beacon and `home` with it, and `choice`, with it.

    Inputs are `x_pe`, `theta` and `home` as the rig reads them; the target is `e` [m] from its linear scale. The round
    trips are of the day of training: they show how large the error gets, and nothing is trained on them.
    rig: parameters of a rig that is built differently.
    """
    found = {}
    for name in (*SCENARIOS, "choice"):
        recording = record("validation" if name == "home" else name, **rig)
        found[name] = record_of(recording, beacon=name in ("home", "training", "choice"))
    return found


def record_of(recording: Recording, beacon: bool) -> Record:
    """What the rig's sensors read, with the beacon or without it."""
    c = recording.channels
    home = c["home"] if beacon else np.zeros_like(c["home"])
    return Record({"x_pe": c["x_pe"], "theta": c["theta"], "home": home}, {"e": c["e"]})


def drum(hidden: tuple[int, ...], seed: int) -> Network:
    """The SNN that `seed` draws."""
    return cable_drum(POSITION, SAMPLE_TIME, hidden, seed)


def fit(network: Network, training: Record) -> Network:
    """Free-run training; modules keep their names and meanings."""
    found = train(network, [training], epochs=EPOCHS, decay=DECAY)
    return network.with_parameters(found.network.parameters())


def starts(progress: Progress = silent, **rig: float) -> tuple[dict[tuple[int, int], Network], dict]:
    """Every size and seed trained, and their RMS [um] on the record `choice`, by (neurons, seed). rig: as `records`."""
    known = records(**rig)
    networks, scores = {}, {}
    for size, seed in product(SIZES, SEEDS):
        networks[size, seed] = fit(drum((size,), seed), known["training"])
        scores[size, seed] = 1e6 * rmse(networks[size, seed], known["choice"])
        progress(f"{size} neurons, seed {seed}: {scores[size, seed]:.1f} um on the record choice")
    return networks, scores


def chosen(scores: dict[tuple[int, int], float]) -> tuple[int, int]:
    """The size by the median of its seeds on the record `choice`, then its best seed."""
    size = min(SIZES, key=lambda n: median(scores[n, seed] for seed in SEEDS))
    return size, min(SEEDS, key=lambda s: scores[size, s])


def train_snn(progress: Progress = silent) -> tuple[Network, dict]:
    """Choose size and seed on the record `choice`, and judge the network on the rest.

    Returns the network and its figures: RMS in um, drift at rest, every table of chapter 7, seconds.
    """
    began = monotonic()
    networks, scores = starts(progress)
    size, seed = chosen(scores)
    network, seconds = networks[size, seed], monotonic() - began
    figures = {
        "um": {name: micrometres(network, name) for name in (*SCENARIOS, "choice")},
        "largest_um": {name: 1e6 * float(np.abs(residual(network, name)).max()) for name in ("validation", "home")},
        "at_rest_um": drift_at_rest(network, records()["training"]),
        "unswitched": unswitched(network),
        "choice_um": {n: [scores[n, s] for s in SEEDS] for n in SIZES},
        "neurons": size,
        "seed": seed,
        "seconds": seconds,
        "tables": tables(progress),
        "thesis": THESIS | VALIDATED,
    }
    return network, figures


def unswitched(network: Network) -> dict[str, float]:
    """The same weights without detector and switch: RMS and drift at rest, um."""
    bare = cable_drum(POSITION, SAMPLE_TIME, (network.layers()["slip.hidden1"].size,), switched=False)
    bare = bare.with_parameters({n: v for n, v in network.parameters().items() if n in bare.parameters()})
    return {
        "training": micrometres(bare, "training"),
        "validation": micrometres(bare, "validation"),
        "at_rest_um": drift_at_rest(bare, records()["training"]),
    }


def residual(network: Network, name: str) -> np.ndarray:
    """Predicted less measured error of one of `records`, m."""
    return float_error(network, records()[name])["e"]


def micrometres(network: Network, name: str, **rig: float) -> float:
    """RMS error of a free run on one of `records`, um. rig: as there."""
    return 1e6 * rmse(network, records(**rig)[name])


def at_rest(network: Network, record: Record) -> np.ndarray:
    """The answer [m] while a minute of rest (HELD samples) follows the longest rest of a recording."""
    moved = np.flatnonzero(np.diff(record.inputs["x_pe"]))
    longest = int(np.argmax(np.diff(moved)))
    start, stop = moved[longest] + 4, moved[longest + 1] + 1  # taps reach two steps back
    inputs = {n: np.append(v[:stop], np.full(HELD, v[stop - 1])) for n, v in record.inputs.items()}
    objective = Objective(network, [Record(inputs, {"e": np.zeros(stop + HELD)})])
    errors = objective.errors(objective.theta)
    return np.full(1, np.inf) if errors is None else ERROR.scale * errors[0][start:, 0]


def drift_at_rest(network: Network, record: Record) -> float:
    """Change of the answer during that rest, um; the sensor does not move."""
    answer = at_rest(network, record)
    return 1e6 * float(np.abs(answer - answer[0]).max())


# ---- black boxes


def black_box(r: Record) -> Record:
    """The same recording with `v_pe` (7.2, Euler) and cosine and sine of the drum's angle as inputs of their own."""
    x, theta = r.inputs["x_pe"], r.inputs["theta"]
    v = np.diff(x, prepend=x[0]) / SAMPLE_TIME
    return Record({"x_pe": x, "v_pe": v, "cos": np.cos(theta), "sin": np.sin(theta)}, r.targets)


def ports() -> dict[str, Port]:
    return {"x_pe": POSITION, "v_pe": Port("v_pe", "m/s", FASTEST), "cos": Port("cos"), "sin": Port("sin")}


def fnn(taps: int, neurons: int, seed: int = 0) -> Network:
    """The network of figure 7.5, with `taps` of position and speed."""
    inputs = {ports()[n]: range(taps) for n in ("x_pe", "v_pe")}
    return nguyen_widrow(nfir("fnn", inputs, ERROR, [neurons], seed, bypass=False), seed)


def recurrent(taps: int, neurons: int, seed: int = 0, turning: bool = False) -> Network:
    """Figures 7.6 and 7.7: also reads the previous error; turning: also cosine and sine of the drum's angle (7.9)."""
    inputs = {ports()[n]: range(taps) for n in ("x_pe", "v_pe")}
    inputs |= {ports()[n]: range(1) for n in ("cos", "sin")} if turning else {}
    return nguyen_widrow(noe("noe", inputs, ERROR, [1], [neurons], seed, bypass=False), seed)


def with_angle(ninth: Network) -> Network:
    """NOE #10: NOE #9 that may also read cosine and sine of the drum's angle, and does not yet."""
    taps, neurons = ARCHITECTURES[-1]
    unread = {name: np.zeros((neurons, 1)) for name in ("hidden1.cos_z0", "hidden1.sin_z0")}
    return recurrent(taps, neurons, turning=True).with_parameters(ninth.parameters() | unread)


def tables(progress: Progress = silent) -> dict:
    """Tables 7.1 to 7.3 and NOE #10: training error in um and seconds by architecture 1 to 9, validation of some."""
    training = black_box(records()["training"])
    found: dict = {"fnn": [], "narx": [], "noe": [], "seconds": {"fnn": [], "narx": [], "noe": []}}

    def run(kind: str, network: Network, epochs: int, teacher: bool = False) -> Network:
        result = train(network, [training], epochs=epochs, teacher=teacher)
        objective = Objective(result.network, [training], teacher=teacher)
        found[kind].append(1e6 * ERROR.scale * float(np.sqrt(objective.squares(objective.theta) / objective.samples)))
        found["seconds"][kind].append(result.seconds)
        progress(f"{kind} #{len(found[kind])}: {found[kind][-1]:.1f} um in {result.seconds:.1f} s")
        return result.network

    for taps, neurons in ARCHITECTURES:
        run("fnn", fnn(taps, neurons), 100)
        ninth = run("noe", run("narx", recurrent(taps, neurons), 100, teacher=True), 10)
    for name, start in (("noe_9_on", ninth), ("noe_10", with_angle(ninth))):
        found[name], found["seconds"][name] = [], []
        network = run(name, start, 100)
        found[name] = {
            "training": found[name][0],
            "validation": 1e6 * rmse(network, black_box(records()["validation"])),
            "at_rest_um": drift_at_rest(network, black_box(records()["training"])),
        }
    return found
