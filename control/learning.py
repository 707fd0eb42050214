"""The network that imitates the predictive controller of any machine, learnt until it tracks as closely."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from greygate.control.choices import JUDGED, Case
from greygate.control.imitation import AHEAD, LAST, Feature, ImitatedAll, Watched, dagger, differences, imitator
from greygate.control.own import Machine
from greygate.control.stepping import Floating, Stepped
from greygate.control.tuning import SAMPLES, Predicted
from greygate.models.network import Network, Port
from greygate.models.training.record import Record
from greygate.progress import Progress, silent

FACTOR = 1.25  # times the predictive controller's error, within which the network matches it
LEARNING = 100  # seed from which on references and days are learnt on
HIDDEN = (10, 20)  # neurons: more where fewer do not match
ROUNDS, EPOCHS, DECAY = 4, 60, 1e-6
RESOLUTION = 2.0**-16  # of a reference, whose codes are as fine
HELD_OUT = 3  # references and days
BACK = (0, 1, 2, 4, 8, 16)  # samples, between which a measured signal's changes are seen


@dataclass(frozen=True)
class Learnt:
    """network: that imitates. apart: case -> its RMS error over the predictive controller's, on held-out references and
    days. ahead: samples by which it sees the reference ahead."""

    network: Network
    apart: Mapping[str, float]
    ahead: int

    @property
    def matches(self) -> bool:
        return max(self.apart.values()) <= FACTOR

    @property
    def said(self) -> str:
        worst = max(self.apart, key=lambda case: self.apart[case])
        found = f"errs {self.apart[worst]:.2f} times as much as predictive control, at most ({worst})"
        lacks = "" if self.matches else f"; it does not match it within {FACTOR:g}"
        return f"on held-out references and days the network {found}{lacks}"


def imitated(machine: Machine, network: Stepped, ahead: int) -> ImitatedAll:
    return ImitatedAll(network, ahead, [p.name for p in machine.drives], machine.tracked)


def untrained(machine: Machine, ahead: int, hidden: int) -> Network:
    """Sees errors, the reference's motion ahead, measured signals and their motion, the last inputs and theirs."""
    seen = {p.name: p for p in machine.signals if p.name in machine.noise}
    steps = [0, *(2**i for i in range(ahead.bit_length()) if 2**i < ahead), ahead]
    features: list[Feature] = []
    ports: list[Port] = []
    for name in machine.tracked:
        port = f"{AHEAD}_{name}"
        ports.append(replace(seen[name], name=port, resolution=seen[name].scale * RESOLUTION))
        features += [{(port, ahead): 1.0, (name, 0): -1.0}, *differences(port, [ahead - s for s in steps])]
    for name in seen:
        features += [{(name, 0): 1.0}, *differences(name, BACK)]
    for drive in machine.drives:
        features += [{(f"{LAST}_{drive.name}", delay): 1.0} for delay in BACK[:3]]
    ports += [*seen.values(), *(replace(p, name=f"{LAST}_{p.name}") for p in machine.drives)]
    name = f"{machine.name}_control"
    return replace(imitator(name, ports, machine.drives, machine.limits, features, hidden, 0), dt=machine.period)


def learnt(machine: Machine, expert: Predicted, progress: Progress = silent) -> Learnt:
    """By DAgger; with more neurons where fewer do not match. The best is returned."""
    tries: list[Learnt] = []
    for hidden in HIDDEN:
        network = _learnt(machine, expert, hidden, progress)
        tries.append(Learnt(network, apart(machine, expert, network), expert.ahead))
        progress(tries[-1].said)
        if tries[-1].matches:
            break
    return min(tries, key=lambda t: max(t.apart.values()))


def _learnt(machine: Machine, expert: Predicted, hidden: int, progress: Progress) -> Network:
    first, seeds = untrained(machine, expert.ahead, hidden), iter(range(LEARNING, JUDGED))
    reads = imitated(machine, Floating(first), expert.ahead)

    def visit(student: Network | None) -> list[Record]:
        records = []
        for case, day in (*((case, machine) for case in Case), (Case.LOAD, replace(machine, shocked=True))):
            driver = imitated(machine, Floating(student), expert.ahead) if student else None
            watched = Watched(driver, expert, reads, machine.limits)
            day.run(watched, case, next(seeds), SAMPLES)
            records.append(watched.record(first, expert.ahead))
        return records

    return dagger(first, visit, ROUNDS, EPOCHS, DECAY, progress)


def apart(machine: Machine, expert: Predicted, network: Network) -> dict[str, float]:
    """Case -> the network's error over the predictive controller's, at most, where it did not learn."""
    own = imitated(machine, Floating(network), expert.ahead)

    def ratio(case: Case, seed: int) -> float:
        one, other = (machine.cost(machine.run(c, case, seed, SAMPLES)) for c in (own, expert))
        return one / other

    return {str(case): max(ratio(case, JUDGED + i) for i in range(1, HELD_OUT + 1)) for case in Case}
