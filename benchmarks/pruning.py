"""The pruning methods on one network: thesis benchmark system 2 (3.6.2), 341 parameters. Error against parameters.

All choices (rounds kept, smallest network) fall on held-out noise; the thesis's validation signal only reports.
"""

from time import perf_counter

import numpy as np

from greygate.compiler.prune import prune_by_entropy
from greygate.compiler.saliency import METHODS, Method, Stage, prune_by_saliency
from greygate.compiler.simplify import parameter_count
from greygate.errors import InputError
from greygate.machines.benchmark_systems.plant import b2, b2_input, b2_test_input
from greygate.models.accuracy import pooled_rms
from greygate.models.families.regression import noe
from greygate.models.network import Network, Port
from greygate.models.training.levenberg import train
from greygate.models.training.record import Record

SIZES = (341, 300, 270, 244, 220, 200, 170, 140, 110, 80)
DECAY = 1e-6


def record(u: np.ndarray) -> Record:
    return Record({"u": u}, {"y": b2(u)})


def trained(seed: int, training: Record) -> Network:
    """20 + 10 neurons, NARX and then NOE."""
    network = noe("b2", {Port("u"): (1, 2)}, Port("y"), (1, 2, 3), (20, 10), seed, bypass=False)
    network = train(network, [training], teacher=True, epochs=150, decay=1e-4).network
    return train(network, [training], epochs=150, decay=DECAY).network


def main() -> None:
    training, held, test = record(b2_input()), record(b2_input(1, 500)), record(b2_test_input())
    began = perf_counter()
    network = trained(0, training)

    def rms(n: Network, r: Record) -> float:
        return float(pooled_rms(n, [r])[0])

    errors = f"{rms(network, training):.2e} training, {rms(network, held):.2e} held out, {rms(network, test):.2e} test"
    print(f"{parameter_count(network)} parameters, trained in {perf_counter() - began:.1f} s, RMS error {errors}")
    print("\nRMS error on held-out noise by parameters, pruned while it is under 0.02")
    print(f"{'':18}" + "".join(f"{size:>9}" for size in SIZES) + "        s")
    for name, method in METHODS.items():
        began = perf_counter()
        result = prune_by_saliency(network, [training], method, 0.02, held=[held], decay=DECAY, goal=SIZES[-1])
        seconds, row = perf_counter() - began, ""
        for size in SIZES:
            try:
                row += f"{rms(result.at(size), held):9.1e}"
            except InputError:
                row += f"{'-':>9}"
        print(f"{name:18}{row}{seconds:9.1f}")
    allowed = 1.5 * rms(network, held)
    print(f"\nthe smallest whose held-out error is at most {allowed:.2e}")
    print(f"{'':18}parameters  neurons  training  held out      test  s to 244        s   rounds")

    def smallest(name: str, start: Network, began: float, method: Method) -> None:
        reached = []

        def note(step: Stage) -> None:
            if step.parameters <= 244:
                reached.append(perf_counter() - began)

        options = {"held": [held], "epochs": 50, "decay": DECAY, "progress": note}
        result = prune_by_saliency(start, [training], method, allowed, **options)
        last = result.steps[-1]
        errors = "".join(f"{rms(last.network, r):10.1e}" for r in (training, held, test))
        when = f"{reached[0]:10.1f}" if reached else f"{'-':>10}"
        seconds = f"{perf_counter() - began:9.1f}"
        print(f"{name:18}{last.parameters:10}{last.neurons:9}{errors}{when}{seconds}{len(result.rounds):9}")

    for name, method in METHODS.items():
        smallest(name, network, perf_counter(), method)
    began = perf_counter()

    def retrain(n: Network) -> Network:
        return train(n, [training], epochs=50, decay=DECAY).network

    fewer, _ = prune_by_entropy(network, [training], retrain, 1.5 * pooled_rms(network, [training]))
    print(f"by entropy {parameter_count(fewer)} parameters, {rms(fewer, held):.1e} held out; then by weights:")
    smallest("entropy, obs", fewer, began, METHODS["obs"])


if __name__ == "__main__":
    main()
