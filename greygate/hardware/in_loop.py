"""Hardware in a closed loop: Verilator answers step by step, each word beside the emulator's, every bit of it.

The designs run in one simulation. Its bench reads `DESIGN WORD` from a pipe, offers the word, and writes the answer of
the design with all its states.
"""

import subprocess
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from greygate.control.stepping import Emulated
from greygate.emulator.program import Program, Signal
from greygate.errors import InputError
from greygate.hardware.replay import PATIENCE, built
from greygate.hardware.verify import Bench, Case, lanes, simulator_environment, width, words
from greygate.progress import Progress, silent

STDIN, STDOUT = "32'h80000000", "32'h80000001"


class Clocked:
    """A design under way in the simulation: closes the loop with what the hardware answers.

    differing: bits of outputs and states in which it differed from the emulator so far. compared: bits in all. first:
    the first step that differed, or None.
    """

    def __init__(self, simulation: subprocess.Popen, bench: Bench):
        self._simulation, self._bench, self.program = simulation, bench, bench.case.program
        self._outputs, self._states = _Lanes(bench.outputs), _Lanes(bench.states)
        self._emulated = Emulated(self.program)
        self.differing = self.compared = self.steps = 0
        self.first: int | None = None

    def reset(self) -> None:
        """A design is reset once, when its simulation begins."""
        if self.steps:
            raise InputError(f"{self.program.name}: a simulation runs once; begin another")

    def step(self, inputs: Mapping[str, float]) -> dict[str, float]:
        """Raises InputError where the design does not answer."""
        wanted = self._emulated.step(inputs)
        codes = self._emulated.inputs[-1]
        word = lanes(self._bench.inputs, codes[None])[0][::-1].tobytes().hex()
        assert self._simulation.stdin
        assert self._simulation.stdout
        try:
            self._simulation.stdin.write(f"{self._bench.index} {word}\n")
            self._simulation.stdin.flush()
            said = self._simulation.stdout.readline().strip()
            seen = np.frombuffer(bytes.fromhex(said), np.uint8)[::-1]
        except (BrokenPipeError, ValueError):
            seen = np.zeros(0, np.uint8)
        split = self._outputs.bytes
        if len(seen) != split + self._states.bytes:
            raise InputError(f"{self.program.name}: no answer within {PATIENCE} clocks at step {self.steps}")
        outputs, states = self._outputs.codes(seen[:split]), self._states.codes(seen[split:])
        expected = lanes(self._bench.outputs, self._emulated.outputs[-1][None])[0]
        expected = np.append(expected, lanes(self._bench.states, self._emulated.states[-1][None])[0])
        bits = int(np.unpackbits(seen ^ expected).sum())
        if bits and self.first is None:
            self.first = self.steps
        self.differing += bits
        self.compared += 8 * len(seen)
        self.steps += 1
        if not bits:
            return wanted
        self._emulated.outputs[-1], self._emulated.states[-1] = outputs, states
        return {n: float(v[0]) for n, v in self.program.decode(outputs[None]).items()}


class _Lanes:
    """Codes in a word of lanes."""

    def __init__(self, signals: Sequence[Signal]):
        self.places, self.bytes = words(signals), width(signals) // 8

    def codes(self, seen: np.ndarray) -> np.ndarray:
        data = seen.tobytes()
        return np.array([int.from_bytes(data[at : at + size], "little", signed=True) for _, size, at in self.places])


@contextmanager
def clocked(cases: Sequence[Case], folder: Path | str, progress: Progress = silent) -> Iterator[list[Clocked]]:
    """Build the designs into one simulation and start it. cases: without scenarios; names must differ.

    folder: receives the Verilog. Raises InputError where a tool is missing or the Verilog cannot be built.
    """
    benches = [Bench(i, case) for i, case in enumerate(cases)]
    files = {f.name: f for case in cases for f in case.sources(Path(folder).resolve())}
    with built(list(files.values()), _bench(benches), {}, (), progress) as work:
        simulation = subprocess.Popen(
            [str(work / "bench")], stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=work, text=True,
            env=simulator_environment(),
        )  # fmt: skip
        try:
            yield [Clocked(simulation, bench) for bench in benches]
        finally:
            assert simulation.stdin
            assert simulation.stdout
            simulation.stdin.close()
            simulation.stdout.close()
            simulation.wait()


def _bench(benches: Sequence[Bench]) -> str:
    parts, reads, acts = [], [], []
    for bench in benches:
        i, ins, outs, states = bench.index, width(bench.inputs), width(bench.outputs), width(bench.states)
        parts.append(f"""\
    reg [{ins - 1}:0] word_{i} = 0;
    reg offer_{i} = 0;
    wire s_ready_{i}, m_valid_{i};
    wire [{outs - 1}:0] m_tdata_{i};
    wire [{outs + states - 1}:0] seen_{i} = {bench.seen()};
    {bench.case.program.name} design_{i} (
        .clk(clk), .rst(rst), .s_axis_tdata(word_{i}), .s_axis_tvalid(offer_{i}), .s_axis_tready(s_ready_{i}),
        .m_axis_tdata(m_tdata_{i}), .m_axis_tvalid(m_valid_{i}), .m_axis_tready(1'b1)
    );
""")
        reads.append(f"            if (which == {i}) begin\n"
                     f'                got = $fscanf({STDIN}, "%h", word_{i});\n'
                     f"                offer_{i} <= 1;\n            end\n")  # fmt: skip
        acts.append(f"            if (offer_{i} && s_ready_{i}) offer_{i} <= 0;\n"
                    f"            if (which == {i} && m_valid_{i}) begin\n"
                    f'                $fwrite({STDOUT}, "%h\\n", seen_{i});\n'
                    f"                $fflush({STDOUT});\n                which = -1;\n            end\n")  # fmt: skip
    return f"""\
module bench (input clk);
    integer which = -1, got, idle = 0;
    reg [2:0] starting = 0;
    wire rst = starting < 4;
{"".join(parts)}    always @(posedge clk) begin
        if (rst) starting <= starting + 1;
        else if (which < 0) begin
            idle = 0;
            got = $fscanf({STDIN}, "%d", which);
            if (got != 1) $finish;
{"".join(reads)}        end else begin
            idle = idle + 1;
            if (idle > {PATIENCE}) $finish;
{"".join(acts)}        end
    end
endmodule
"""
