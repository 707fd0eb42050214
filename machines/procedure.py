"""The procedure of thesis figure 3.3, from subsystems to a pruned network, with a ledger of error and size.

snn = Procedure({"training": training, "v1": v1}, subsystems=("flow", "divider"))
snn.take("flow", fit_flow(seed=1), flow_record())    # a library network, or one that was trained
snn.take("divider", fit_divider(seed=0), divider_record())
snn.join(assemble)                                   # assemble(flow=..., divider=...) -> Network
snn.train(epochs=25, decay=1e-6)
snn.simplify()
snn.prune(allowed=1.02)                              # neurons, by entropy
snn.prune(obs, allowed=1.02)                         # weights, by a method of models/saliency.py
print(snn)
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from time import monotonic

from greygate.compiler.pipeline import entropy_pruning
from greygate.errors import InputError
from greygate.models.accuracy import free_run_rms
from greygate.models.network import Network
from greygate.models.prune import Round, retrained
from greygate.models.saliency import Method, saliency_pruning
from greygate.models.simplify import parameter_count, simplify
from greygate.models.training.levenberg import Trained, train
from greygate.models.training.record import Record

OWN = "own record"  # heading of a part's error, on the record of its own ports


@dataclass(frozen=True)
class Step:
    """The network that one step made, and its figures.

    errors: {scenario: {output: RMS error of a free run in its unit; inf where it diverges}}.
    neurons: of layers that are not linear. parameters: weights and biases that are not zero.
    """

    name: str
    network: Network
    neurons: int
    parameters: int
    errors: Mapping[str, Mapping[str, float]]
    seconds: float
    note: str = ""


class Procedure:
    """The steps from networks of subsystems to one network that is trained, simplified and pruned.

    records: scenarios by name; every step after `join` is judged on all of them. training: names of the records that
    `train` and `prune` may see; the first record if none is named. subsystems: names of the parts that `join` needs.
    Each method adds a `Step` to `steps` and returns its network. A step keeps its network, so it can be undone. `print`
    shows the steps as a ledger.
    """

    def __init__(self, records: Mapping[str, Record], subsystems: Sequence[str] = (), training: Sequence[str] = ()):
        if not records:
            raise InputError("procedure: no records; give at least the one to train on")
        for name in training:
            if name not in records:
                raise InputError(f"procedure: no record {name!r} to train on; there are {', '.join(records)}")
        self.records = dict(records)
        self.subsystems = tuple(subsystems)
        self.training = tuple(training) or tuple(records)[:1]
        self.parts: dict[str, Network] = {}
        self.steps: list[Step] = []

    @property
    def network(self) -> Network:
        """The joined network, as the last step left it. Raises InputError before `join`."""
        if not self.steps or self.steps[-1].name in self.parts:
            raise InputError("procedure: there is no joined network yet; join the parts first")
        return self.steps[-1].network

    def take(self, name: str, part: Network | Trained, record: Record | None = None) -> Network:
        """Add a subsystem's network, from the library or trained. record: of its own ports; it is judged on that."""
        if self.subsystems and name not in self.subsystems:
            raise InputError(f"procedure: no subsystem {name!r}; there are {', '.join(self.subsystems)}")
        network, note = _unpacked(part)
        self.parts[name] = network
        seconds = part.seconds if isinstance(part, Trained) else 0.0
        return self._add(name, network, {OWN: record} if record else {}, seconds, note)

    def join(self, build: Callable[..., Network] | Network) -> Network:
        """Join the parts, `build(**parts)`; or take a network as it is, to adapt it to another machine."""
        if missing := [name for name in self.subsystems if name not in self.parts]:
            raise InputError(
                f"procedure: nothing was taken for {', '.join(missing)}; take a network for each subsystem"
            )
        return self.step("joined", lambda: build if isinstance(build, Network) else build(**self.parts))

    def train(self, **options) -> Network:
        """Train the joined network on the training records. options: of `models.training.levenberg.train`."""
        records = [self.records[name] for name in self.training]
        return self.step("trained", partial(train, self.network, records, **options))

    def simplify(self) -> Network:
        """Make the generic network: the same function with fewer layers."""
        return self.step("simplified", partial(simplify, self.network))

    def prune(
        self, method: Method | None = None, allowed: float = 1.02, epochs: int = 4, also: Sequence[Record] = ()
    ) -> Network:
        """Remove neurons by entropy (3.6), or weights by a method of `compiler.saliency`.

        allowed: factor by which the RMS error of each output over the training records and `also` may rise. After each
        removal the network is trained again on these records for `epochs`.
        """
        records = [*(self.records[name] for name in self.training), *also]
        if method:
            pruning = saliency_pruning(records, method, allowed, epochs=epochs)
        else:
            pruning = entropy_pruning(records, partial(retrained, records=records, epochs=epochs), allowed)
        return self.step(f"pruned by {method.__name__ if method else 'entropy'}", partial(pruning, self.network))

    def step(self, name: str, work: Callable[[], Network | Trained | tuple[Network, list[Round]]]) -> Network:
        """Do any other step: time `work()` and judge the network that it returns on every record."""
        began = monotonic()
        network, note = _unpacked(work())
        return self._add(name, network, self.records, monotonic() - began, note)

    def _add(self, name: str, network: Network, records: Mapping[str, Record], seconds: float, note: str) -> Network:
        neurons = network.neurons()
        errors = {scenario: free_run_rms(network, record) for scenario, record in records.items()}
        self.steps.append(Step(name, network, neurons, parameter_count(network), errors, seconds, note))
        return network

    def __getitem__(self, name: str) -> Step:
        """The last step of that name. Raises InputError naming those there are."""
        for step in reversed(self.steps):
            if step.name == name:
                return step
        raise InputError(f"procedure: no step {name!r}; there are {', '.join(s.name for s in self.steps) or 'none'}")

    def __str__(self) -> str:
        """The ledger as text: a row a step, RMS errors by scenario, outputs side by side."""
        scenarios = list(dict.fromkeys(n for step in self.steps for n in step.errors))
        rows = [("step", "neurons", "parameters", *scenarios, "seconds", "")]
        for step in self.steps:
            cells = [_cell(step.network, step.errors.get(n, {})) for n in scenarios]
            rows.append((step.name, str(step.neurons), str(step.parameters), *cells, f"{step.seconds:.1f}", step.note))
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = []
        for name, *figures, note in rows:
            middle = (f"{f:>{w}}" for f, w in zip(figures, widths[1:], strict=False))
            lines.append("  ".join([f"{name:{widths[0]}}", *middle, note]).rstrip())
        return "\n".join(lines)


def bar(errors: Mapping[str, Mapping[str, float]]) -> dict[str, tuple[float, ...]]:
    """Pressures of `Step.errors` in bar: {scenario: one figure an output}."""
    return {scenario: tuple(v / 1e5 for v in by_output.values()) for scenario, by_output in errors.items()}


def _unpacked(result: Network | Trained | tuple[Network, list[Round]]) -> tuple[Network, str]:
    """The network in what a step gave, and a word on how it went."""
    if isinstance(result, Trained):
        return result.network, f"{len(result.history) - 1} epochs. {result.outcome.value}"
    if isinstance(result, tuple):
        network, rounds = result
        return network, f"{sum(r.kept for r in rounds)} of {len(rounds)} rounds kept"
    return result, ""


def _cell(network: Network, errors: Mapping[str, float]) -> str:
    """`0.183 / 0.473 bar`: outputs of one unit share it."""
    units = {port.name: ("bar" if port.unit == "Pa" else port.unit) for port in network.outputs}
    figures = [f"{v * (1e-5 if units[n] == 'bar' else 1.0):.3g}" for n, v in errors.items()]
    names = {units[n] for n in errors}
    if len(names) > 1:
        return " / ".join(f"{f} {units[n]}" for f, n in zip(figures, errors, strict=True))
    return f"{' / '.join(figures)} {names.pop()}".removesuffix(" 1") if figures else ""
