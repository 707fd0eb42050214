"""The pipelined architecture: a sample with every clock, or as often as feedback allows, and several under way at once.

A signal has a stage, the clocks after its sample was taken; whoever reads it later reads it behind registers. One
enable holds everything while a result waits. A state is written in the stage of its source, and read so early that the
sample before has written it: without feedback that is the next clock; a feedback loop spaces the samples by its length.

With `Design.channels` the samples belong to so many channels in turn. Each channel has its own states, so that the
samples of one stand further apart, and a loop that is no longer than the channels are many costs no clock.
"""

from greygate.compiler.dataflow import Dataflow
from greygate.compiler.targets import Architecture, Design, Register
from greygate.compiler.verilog import header, module_text, top_ports, verilog_names
from greygate.emulator.program import Program, Signal


def pipelined(program: Program, design: Design = Design()) -> dict[str, str]:
    """File name -> text of the pipelined architecture, without the building blocks."""
    core = _Pipelined(program, design)
    return {f"{program.name}.v": core.top()} | core.modules()


def registers(program: Program, design: Design = Design()) -> list[Register]:
    """A register for each state, with the name of the state."""
    names = verilog_names(program)
    signals = [s.signal for s in program.states]
    return [Register(names[s.name], k * s.fix.width) for s in signals for k in range(s.size)]


TARGET = Architecture(pipelined, registers)


class _Pipelined(Dataflow):
    """stage: signal -> its stage. interval: clocks from a sample to the next."""

    def __init__(self, program: Program, design: Design):
        super().__init__(program, design, pipelined=True)
        self.interval, self.stage = self._scheduled()
        self.taken.add("channel")
        self.stored: dict[str, str] = {}  # state -> the registers of its channels
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
        program = self.program
        ports, width_in, width_out = top_ports(program)
        depth = max(self.stage.values())
        layers, states = self.layers(), self.states()
        result = self.outputs({p.signal.name: self.at(p.signal.name, depth) for p in program.outputs})
        body = f"""\
module {program.name} (
{ports}
);

    localparam DEPTH = {depth};  // clocks from a sample in its register to its result

    reg [{width_in - 1}:0] sample;
    wire [{width_out - 1}:0] result;
{self.edge(width_out, depth)}{self.inputs()}{states}{self.wires()}{self.delays()}{layers}{self.next_states()}"""
        return module_text(header(program, "pipelined"), body + self.unread() + result.rstrip("\n") + "\n")

    def edge(self, width_out: int, depth: int) -> str:
        """The two streams, and which stages hold a sample."""
        answer, valid = self.fresh("answer"), self.fresh("answer_valid")
        ready, text = "1'b1", ""
        if self.interval > 1:
            rest = self.fresh("rest")
            width = (self.interval - 1).bit_length()
            text = f"""
    reg [{width - 1}:0] {rest};  // clocks until the states are those of the next sample
    always @(posedge clk)
        if (rst) {rest} <= {width}'d0;
        else if (en) {rest} <= s_axis_tvalid && s_axis_tready ? {width}'d{self.interval - 1} :
            {rest} - {{{f"{width - 1}'d0, " if width > 1 else ""}{rest} != {width}'d0}};
"""
            ready = f"{rest} == {width}'d0"
        following = "taken" if depth == 0 else "{stage[DEPTH-1:0], taken}"
        taken = self.fresh("taken")
        following = following.replace("taken", taken)
        return f"""\
    reg [{width_out - 1}:0] {answer};
    reg {valid};
    reg [DEPTH:0] stage;  // the stages that hold a sample
    wire en = !{valid} || m_axis_tready;
    wire {taken} = s_axis_tvalid && s_axis_tready;
{text}
    assign s_axis_tready = en && !rst && {ready};
    assign m_axis_tdata = {answer};
    assign m_axis_tvalid = {valid};

    always @(posedge clk)
        if (rst) begin
            stage <= {{DEPTH + 1{{1'b0}}}};
            {valid} <= 1'b0;
        end else if (en) begin
            stage <= {following};
            {valid} <= stage[DEPTH];
        end

    always @(posedge clk)
        if (en) begin
            sample <= s_axis_tdata;
            {answer} <= result;
        end
{self.turns(taken)}"""

    def states(self) -> str:
        """A register for each state, or one a channel, read for the channel whose sample is in the state's stage."""
        if not self.program.states:
            return ""
        head = "\n    // states: what their sources held for the sample before\n"
        if self.design.channels == 1:
            return head + "".join(self.vector("reg", s.signal) for s in self.program.states)
        for s in self.program.states:
            name = self.stored[s.signal.name] = self.fresh(f"{self.names[s.signal.name]}_of")
            width = s.signal.size * s.signal.fix.width
            head += f"    reg [{width - 1}:0] {name} [0:{self.design.channels - 1}];\n"
            head += self.vector("wire", s.signal, f" = {name}[{self.channel(self.stage[s.signal.name])}]")
        return head

    def channel(self, stage: int) -> str:
        """The channel of the sample in a stage."""
        width = self.channel_bits
        return f"channel[{(stage + 1) * width - 1}:{stage * width}]"

    @property
    def channel_bits(self) -> int:
        return (self.design.channels - 1).bit_length()

    def turns(self, taken: str) -> str:
        """The channel of the next sample, and that of the sample in each stage."""
        if self.design.channels == 1 or not self.program.states:
            return ""
        turn, width, last = self.fresh("turn"), self.channel_bits, self.design.channels - 1
        depth = max(self.stage[s.source] for s in self.program.states)  # where the last state is written
        following = turn if not depth else f"{{channel[{depth * width - 1}:0], {turn}}}"
        return f"""
    reg [{width - 1}:0] {turn};  // the channel of the next sample
    reg [{(depth + 1) * width - 1}:0] channel;  // that of the sample in each stage
    always @(posedge clk)
        if (rst) {turn} <= {width}'d0;
        else if ({taken}) {turn} <= {turn} == {width}'d{last} ? {width}'d0 : {turn} + {width}'d1;
    always @(posedge clk) if (en) channel <= {following};
"""

    def wires(self) -> str:
        return "\n    // layers\n" + "".join(self.vector("wire", o.out) for o in self.program.operations)

    def layers(self) -> str:
        text = ""
        for o in self.program.operations:
            stage = max(self.stage[a] for a in o.args)
            text += "\n" + self.layer(o, [self.at(a, stage) for a in o.args], "en")
        return text

    def delays(self) -> str:
        """The registers between a signal and whoever reads it in a later stage."""
        signals: dict[str, Signal] = self.program.signals
        following = [
            (q, before, signals[name])
            for name, chain in self.chains.items()
            for before, q in zip([self.names[name], *chain], chain, strict=False)
        ]
        if not following:
            return ""
        declared = "".join(f"    reg [{s.size * s.fix.width - 1}:0] {q};\n" for q, _, s in following)
        lines = "".join(f"            {q} <= {before};\n" for q, before, _ in following)
        return (
            f"\n    // signals in later stages\n{declared}\n"
            f"    always @(posedge clk)\n        if (en) begin\n{lines}        end\n"
        )

    def next_states(self) -> str:
        """A state takes the value of its source as a sample passes."""
        text = ""
        for s in self.program.states:
            y, source = self.names[s.signal.name], self.names[s.source]
            stage = self.stage[s.source]
            initial = self.initial()[s.signal.name]
            if s.signal.name in self.stored:
                y = self.stored[s.signal.name]
                text += "        if (rst) begin\n"
                text += "".join(f"            {y}[{k}] <= {initial};\n" for k in range(self.design.channels))
                text += f"        end else if (en && stage[{stage}]) {y}[{self.channel(stage)}] <= {source};\n"
                continue
            text += f"        if (rst) {y} <= {initial};\n"
            text += f"        else if (en && stage[{stage}]) {y} <= {source};\n"
        return f"\n    always @(posedge clk) begin\n{text}    end\n" if text else ""
