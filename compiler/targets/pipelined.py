"""The pipelined architecture: a sample with every clock, or as often as feedback allows, and several under way at once.

A signal has a stage, the clocks after its sample was taken; whoever reads it later reads it behind registers. One
enable holds everything while a result waits. A state is written in the stage of its source, and read so early that the
sample before has written it: without feedback that is the next clock; a feedback loop spaces the samples by its length.

With `Design.channels` the samples belong to so many channels in turn. Each channel has its own states, so that the
samples of one stand further apart, and a loop that is no longer than the channels are many costs no clock.
"""

from greygate.compiler.dataflow import Dataflow
from greygate.compiler.targets import Architecture, Design
from greygate.compiler.targets.parallel import registers
from greygate.compiler.verilog import header, module_text, render, skid_instance, stream_widths
from greygate.emulator.program import Program, Signal


def pipelined(program: Program, design: Design = Design()) -> dict[str, str]:
    """File name -> text of the pipelined architecture, without the building blocks."""
    core = _Pipelined(program, design)
    return {f"{program.name}.v": core.top()} | core.modules()


TARGET = Architecture(pipelined, registers)


class _Pipelined(Dataflow):
    """stage: signal -> its stage. interval: clocks from a sample to the next."""

    def __init__(self, program: Program, design: Design):
        super().__init__(program, design, pipelined=True)
        self.interval, self.stage = self._scheduled()
        self.taken.add("channel")
        self.chains: dict[str, list[str]] = {}  # signal -> it one clock later, two clocks later, ...

    def _scheduled(self) -> tuple[int, dict[str, int]]:
        """The least interval at which every state is written before it is read."""
        interval = 1
        while (stage := self._stages(interval)) is None:
            interval += 1
        return interval, stage

    def _stages(self, interval: int) -> dict[str, int] | None:
        """The stages for an interval, None if a feedback loop is longer."""
        stage = dict.fromkeys(self.program.signals, 0)
        for _ in range(len(self.program.states) + 2):
            before = dict(stage)
            for o in self.program.operations:
                stage[o.out.name] = self.clocks(o) + max(stage[a] for a in o.args)
            for s in self.program.states:
                stage[s.signal.name] = max(0, stage[s.source] + 1 - interval * self.design.channels)
            if stage == before:
                return stage
        return None

    def at(self, name: str, stage: int) -> str:
        """The wire of a signal in a stage."""
        chain = self.chains.setdefault(name, [])
        late = stage - self.stage[name]
        while len(chain) < late:
            chain.append(self.fresh(f"{self.names[name]}_q{len(chain) + 1}"))
        return chain[late - 1] if late else self.names[name]

    def top(self) -> str:
        """The top module."""
        program, channels = self.program, self.design.channels
        depth, layers = max(self.stage.values()), self.layers()
        stored = {}  # state -> the registers of its channels
        if channels > 1:
            stored = {s.signal.name: self.fresh(f"{self.names[s.signal.name]}_of") for s in program.states}
        result = self.outputs({p.signal.name: self.at(p.signal.name, depth) for p in program.outputs})
        named = {"core": self, "program": program, "names": self.names, "initial": self.initial()}
        widths = stream_widths(program)
        named |= {"depth": depth, "stored": stored, **widths}
        named |= {"answer": self.fresh("answer"), "valid": self.fresh("answer_valid")}
        named |= {"rest": self.fresh("rest") if self.interval > 1 else "", "taken": self.fresh("taken")}
        entry = {name: self.fresh(name) for name in ("beat", "offered", "room")}
        named |= entry | {"skid": skid_instance(widths["width_in"], *entry.values())}
        named |= {"rest_bits": (self.interval - 1).bit_length(), "turn": self.fresh("turn") if stored else ""}
        named |= {"channels": channels, "channel_bits": self.channel_bits, "delays": self.delays(), "layers": layers}
        named |= {"deepest": max((self.stage[s.source] for s in program.states), default=0)}  # the last state's
        body = render("pipelined.v", named | {"result": result.rstrip("\n") + "\n"})
        return module_text(header(program, "pipelined"), body)

    def channel(self, stage: int) -> str:
        """The channel of the sample in a stage."""
        return f"channel[{(stage + 1) * self.channel_bits - 1}:{stage * self.channel_bits}]"

    @property
    def channel_bits(self) -> int:
        return (self.design.channels - 1).bit_length()

    def layers(self) -> str:
        text = ""
        for o in self.program.operations:
            stage = max(self.stage[a] for a in o.args)
            text += "\n" + self.layer(o, [self.at(a, stage) for a in o.args], "en")
        return text

    def delays(self) -> list[tuple[str, str, Signal]]:
        """(register, what it takes, signal) between a signal and whoever reads it in a later stage."""
        return [
            (late, before, self.program.signals[name])
            for name, chain in self.chains.items()
            for before, late in zip([self.names[name], *chain], chain, strict=False)
        ]
