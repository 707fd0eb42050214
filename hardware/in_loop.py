"""Hardware in a closed loop: Verilator answers step by step, each word beside the emulator's, every bit of it.

The designs run in one simulation. Its bench reads `WHAT DESIGN WORD` from a pipe, resets the design or offers it the
word, and writes the answer of the design with all its states, and the clocks that it took.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from greygate.children import PIPE, Popen, started
from greygate.compiler.verilog import render
from greygate.control.choices import Method, Place
from greygate.control.loop import Controller
from greygate.control.stepping import Emulated
from greygate.emulator.program import Signal
from greygate.errors import InputError
from greygate.files import scratch
from greygate.hardware.replay import PATIENCE, built
from greygate.hardware.verify import Bench, Case, lanes, simulator_environment, width, words
from greygate.machines.control import Task
from greygate.progress import Progress, silent

STDIN, STDOUT = "32'h80000000", "32'h80000001"
OFFER, RESET = 0, 1  # what is said to the bench
LONG = 4  # clocks of a reset


class Clocked:
    """A design under way in the simulation: closes the loop with what the hardware answers.

    Over all runs: differing, bits of outputs and states in which it differed from the emulator; compared, bits in all;
    steps; clocks that it took for them. first: the first step that differed, or None.
    """

    def __init__(self, simulation: Popen, bench: Bench):
        self._simulation, self._bench, self.program = simulation, bench, bench.case.program
        self._emulated = Emulated(self.program)
        self.differing = self.compared = self.steps = self.clocks = 0
        self.first: int | None = None

    def reset(self) -> None:
        self._emulated.reset()
        self._say(RESET, "0")

    def _say(self, what: int, word: str) -> None:
        pipe = self._simulation.stdin
        assert pipe
        with suppress(BrokenPipeError):  # what ended says so where it is asked for an answer
            pipe.write(f"{what} {self._bench.index} {word}\n")
            pipe.flush()

    def step(self, inputs: Mapping[str, float]) -> dict[str, float]:
        """Raises InputError where the design does not answer."""
        wanted = self._emulated.step(inputs)
        codes, expected, state = self._emulated.inputs, self._emulated.outputs, self._emulated.state
        self._say(OFFER, lanes(self._bench.inputs, codes[None])[0][::-1].tobytes().hex())
        assert self._simulation.stdout
        said = self._simulation.stdout.readline().split()
        if len(said) != 2:
            raise InputError(f"{self.program.name}: no answer within {PATIENCE} clocks at step {self.steps}")
        seen = np.frombuffer(bytes.fromhex(said[0]), np.uint8)[::-1]
        split = width(self._bench.outputs) // 8
        known = np.append(lanes(self._bench.outputs, expected[None])[0], lanes(self._bench.states, state[None])[0])
        bits = int(np.unpackbits(seen ^ known).sum())
        if bits and self.first is None:
            self.first = self.steps
        self.differing += bits
        self.compared += 8 * len(seen)
        self.clocks += int(said[1])
        self.steps += 1
        if not bits:
            return wanted
        return {n: float(v[0]) for n, v in self.program.decode(_codes(self._bench.outputs, seen[:split])).items()}


def _codes(signals: Sequence[Signal], seen: np.ndarray) -> np.ndarray:
    """The codes (1, columns) in the bytes of a word of lanes."""
    data = seen.tobytes()
    return np.array([[int.from_bytes(data[at : at + size], "little", signed=True) for _, size, at in words(signals)]])


@contextmanager
def clocked(cases: Sequence[Case], folder: Path | str, progress: Progress = silent) -> Iterator[list[Clocked]]:
    """Build the designs into one simulation and start it. cases: without scenarios; names must differ.

    folder: receives the Verilog. Raises InputError where a tool is missing or the Verilog cannot be built.
    """
    benches = [Bench(i, case) for i, case in enumerate(cases)]
    files = {f.name: f for case in cases for f in case.sources(Path(folder).resolve())}
    widths = [{"ins": width(b.inputs), "outs": width(b.outputs), "states": width(b.states)} for b in benches]
    tops = [{"i": b.index, "top": b.case.program.name, "seen": b.seen()} for b in benches]
    context = {"designs": [top | own for top, own in zip(tops, widths, strict=True)], "patience": PATIENCE}
    context |= {"stdin": STDIN, "stdout": STDOUT, "offer": OFFER, "reset": RESET, "long": LONG}
    with built(list(files.values()), render("in_loop.v", context, __package__), {}, (), progress) as work:
        command, environment = [str(work / "bench")], simulator_environment()
        with started(command, cwd=work, env=environment, stdin=PIPE, stdout=PIPE) as simulation:
            yield [Clocked(simulation, bench) for bench in benches]


@contextmanager
def controller(
    task: Task, method: Method, place: Place = Place.FLOAT, progress: Progress = silent
) -> Iterator[tuple[Controller, list[Clocked]]]:
    """The controller, and the designs that it is made of where it is hardware: imitating network and sensor.

    Raises InputError where a PI or predictive controller is asked for in the emulator or in hardware.
    """
    if method is not Method.NETWORK:
        if place is not Place.FLOAT:
            raise InputError(f"{method} runs in float; only the imitating network is compiled: take network")
        yield (task.proportional() if method is Method.PI else task.predictive()), []
        return
    network = task.network()
    if place is Place.FLOAT:
        yield task.floating(network), []
        return
    progress("compiling soft sensor and controller")
    programs = task.programs(network)
    if place is Place.EMULATOR:
        yield task.imitated(*map(Emulated, programs)), []
        return
    cases = [Case(program, {}) for program in programs]
    with scratch() as folder, clocked(cases, folder, progress) as designs:
        yield task.imitated(*designs), designs
