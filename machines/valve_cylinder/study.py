"""The SRNN of the valve-controlled cylinder, trained on its simulated rig (thesis 5.3)."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np

from greygate.machines.procedure import OWN, Procedure, bar
from greygate.machines.valve_cylinder.network import driven_spool, valve_srnn
from greygate.machines.valve_cylinder.plant import SPOOL, spool_discrete, valve_cylinder
from greygate.machines.valve_cylinder.scenarios import measure, scenario
from greygate.models.accuracy import float_error, pooled_rms
from greygate.models.families.blocks import divider_record, fit_divider, fit_flow, flow_record
from greygate.models.network import Network
from greygate.models.prune import Round, prune_by_entropy, retrained
from greygate.models.saliency import Method, prune_by_saliency
from greygate.models.training.record import Record
from greygate.plants.excitation import band_limited_noise, prms
from greygate.plants.recording import Recording
from greygate.progress import Progress, silent, titled

SCENARIOS = ("training", "v1", "v2")
THESIS = {  # RMS in bar, chambers A and B (table 5.4, section 5.3.3)
    "assembled": (0.396, 0.773),
    "training": (0.190, 0.598),
    "v1": (0.552, 0.430),
    "v2": (0.758, 0.540),
}
THESIS_FLOW = 1.42e-4  # RMS of Network Qa over Q_max: 8.52e-9 of 6e-5 m^3/s
FLOW_SEED, DIVIDER_SEED = 1, 0
REHEARSAL = 1.0  # a sample of the parts' own records counts like one of the training scenario
EPOCHS = 25
PRUNING_EPOCHS = 4


@lru_cache
def records() -> dict[str, Record]:
    """Training, v1, v2: `v_c` [V] and `x` [m] as the sensors give them; targets are the true pressures [Pa]."""
    return {name: record(scenario(name)) for name in SCENARIOS}


def record(scenario: Recording) -> Record:
    """What the sensors of a scenario give, beside the true pressures."""
    c = scenario.channels
    return Record({n: c[n] for n in ("v_c", "x")}, {n: c[n] for n in ("p_a", "p_b")})


def nominal(recording: Recording) -> dict[str, float]:
    """The parameters of `valve_srnn`: the plant's, the supply's mean pressure, and the chambers' as the run begins."""
    k = {symbol: p.value for symbol, p in valve_cylinder().parameters.items()}
    rest = float(recording["p_a"][0])
    k |= {"p_s": float(np.mean(recording["p_s"])), "p_a_rest": rest, "p_b_rest": rest}
    return k | {"area_a": k["area"], "area_b": k["area"]}


def assemble(
    flow: Network, divider: Network, training: Recording | None = None, taps: int = 4, mean: bool = True
) -> Network:
    """The SRNN with the plant's nominal parameters. Supply pressure is the gauge's mean over the training run.

    training: that run; by default the scenario of that name. taps: of `valve_srnn`; one in the thesis. mean: whether
    the network takes the spool's mean over an interval or, as in the thesis, where it is at the sample.
    """
    k = nominal(training or scenario("training"))
    a, b, c, d = spool_discrete(valve_cylinder())
    if not mean:
        c, d = a[SPOOL], float(b[SPOOL])
    return valve_srnn(k, flow, divider, driven_spool(a, b, c, d, k["u_max"]), taps=taps)


def tuning() -> dict:
    """How the joined network is trained: options of `models.training.levenberg.train`."""
    q, d = (replace(r, weight=REHEARSAL) for r in (flow_record(), divider_record()))
    return {"epochs": EPOCHS, "decay": 1e-6, "rehearse": {"qa": q, "qb": q, "pa.divider": d, "pb.divider": d}}


def train_srnn(progress: Progress = silent) -> tuple[Network, dict]:
    """Fit the parts, join them, and train the joined network on the training scenario; return it and its figures.

    progress: gets lines of text. Figures: RMS in bar of each scenario as assembled and as trained; seconds.
    """
    snn = Procedure(records(), subsystems=("flow", "divider"))
    snn.take("flow", fit_flow(FLOW_SEED, progress=titled(progress, "flow")), flow_record())
    snn.take("divider", fit_divider(DIVIDER_SEED, progress=titled(progress, "divider")), divider_record())
    snn.join(assemble)
    snn.train(**tuning(), progress=titled(progress, "SRNN"))
    figures = {
        "flow_rms": snn["flow"].errors[OWN]["y"],
        "divider_rms": snn["divider"].errors[OWN]["y"],
        "assembled": bar(snn["joined"].errors),
        "trained": bar(snn["trained"].errors),
        "thesis": THESIS | {"flow_rms": THESIS_FLOW},
        "seconds": {"flow": snn["flow"].seconds, "divider": snn["divider"].seconds, "srnn": snn["trained"].seconds},
        "outcome": snn["trained"].note,
    }
    return snn.network, figures


def exercise(network: Network) -> Record:
    """Another run of the rig under a random force, with the network's own answers as targets.

    It shows pruning the behaviour of the network beyond the training scenario, and nothing new about the plant.
    """
    v_c = prms(10_000, -1.0, 1.0, (20, 150), seed=11)
    force = band_limited_noise(10_000, 1500.0, 0.1, 5.0, 1e-3, seed=12)
    c = measure(valve_cylinder(), v_c, force, source="exercise").channels
    inputs = {n: c[n] for n in ("v_c", "x")}
    bare = Record(inputs, {n: c[n] for n in ("p_a", "p_b")})
    errors = float_error(network, bare)
    return Record(inputs, {n: bare.targets[n] + errors[n] for n in errors})


def prune(
    network: Network, allowed: float, weights: Method | None = None, progress: Callable[[str], None] | None = None
) -> tuple[Network, list[Round]]:
    """Entropy pruning of the generic network, then its weights by a method of `compiler.saliency`, if one is given.

    allowed: factor by which each chamber's RMS error over training scenario and `exercise` may rise; the exercise
    preserves the behaviour of the network under load.
    """
    kept = [records()["training"], exercise(network)]
    say = progress or (lambda line: None)

    def retrain(smaller: Network) -> Network:
        say(f"retraining with {sum(layer.size for layer in smaller.layers().values())} neurons")
        return retrained(smaller, kept, PRUNING_EPOCHS)

    bound = allowed * pooled_rms(network, kept)
    network, rounds = prune_by_entropy(network, kept, retrain, bound)
    if weights:
        pruned = prune_by_saliency(network, kept, weights, bound, epochs=PRUNING_EPOCHS, progress=say)
        network, rounds = pruned.network, [*rounds, *pruned.rounds]
    return network, rounds
