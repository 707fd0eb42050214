"""Commands that make a build of a network: compile, explore."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from greygate.cli import options, words
from greygate.cli.backends import Backend, OnBackend, Scheduler, joblib_on
from greygate.cli.terminal import Json, following, give, recordings, say
from greygate.cli.words import Architecture
from greygate.compiler.targets import BOTH, Design
from greygate.errors import InputError
from greygate.progress import Progress

if TYPE_CHECKING:
    from greygate.compiler.pipeline import Compiled
    from greygate.hardware.exploring import Explorer
    from greygate.machines.source import Source

EVERY = Architecture("both")
Out = Annotated[Path, typer.Option(metavar="FOLDER", help="Folder to write; replaced if it is an earlier compilation.")]
Held = Annotated[list[str], words.HELD]
MaxError = Annotated[str | None, words.MAX_ERROR]
Width = Annotated[int, typer.Option(callback=options.WIDTH, help="Word width of signals and weights, 4 to 32 bits.")]
Finer = Annotated[
    int | None, typer.Option(callback=options.FINER, help="Bits of weights and neurons beyond the width.")
]
Prune = Annotated[
    float | None, typer.Option(callback=options.ALLOWANCE, help="Entropy pruning; RMSE may grow by this factor.")
]
Weights = Annotated[
    str | None, typer.Option(help="Then prune single weights: obs, obd, magnitude, multi_obs, unit_obs, ...")
]
Generic = Annotated[bool, typer.Option(help="Merge linear layers even where that costs multipliers.")]
Of = Annotated[Architecture, words.ARCHITECTURE]
Macs = Annotated[int, typer.Option(callback=options.MACS, help="Multipliers of the folded architecture.")]
Factor = Annotated[
    int, typer.Option(callback=options.FACTOR, help="Bits of their widest factor; an iCE40 has 16 in one DSP.")
]
Dsps = Annotated[int, typer.Option(callback=options.DSPS, help="Tables of the parallel one that multiply in a DSP.")]


def compile(
    context: typer.Context,
    network: words.Network,
    out: Out,
    record: words.Recordings = [],
    held: Held = [],
    width: Width = 16,
    finer: Finer = None,
    max_error: MaxError = None,
    prune: Prune = None,
    weights: Weights = None,
    generic: Generic = False,
    architecture: Of = EVERY,
    macs: Macs = 4,
    factor: Factor = 18,
    dsps: Dsps = 0,
    as_json: Json = False,
) -> None:
    """Write a network as Verilog: simplified, pruned, quantized.

    Recordings set the ranges, but for --held. --max-error 1.05x stands instead of a width.
    """
    given, design = _given(context), Design(multipliers=macs, factor=factor, dsps=dsps)
    growth = _growth(max_error)
    wanted = _Wanted(given, network, out, record, held, width, finer, prune, weights, generic, architecture, design)
    with following(f"compiling {network}") as progress:
        compiled = wanted.compiled(progress, budget=growth)
    result, told = wanted.told(compiled)
    give("compile", result, as_json, told)


def explore(
    context: typer.Context,
    network: words.Network,
    target: Annotated[words.Target, words.TARGET],
    out: Out,
    record: words.Recordings = [],
    max_error: MaxError = None,
    max_latency: Annotated[str | None, typer.Option(help="Time of a step, such as 2us.")] = None,
    max_luts: Annotated[int | None, typer.Option(callback=options.LUTS, help="LUTs.")] = None,
    max_dsps: Annotated[int | None, typer.Option(callback=options.DSPS, help="DSPs.")] = None,
    max_memories: Annotated[float | None, typer.Option(callback=options.MEMORIES, help="Blocks of memory.")] = None,
    held: Held = [],
    width: Width = 16,
    finer: Finer = None,
    prune: Prune = None,
    weights: Weights = None,
    generic: Generic = False,
    architecture: Of = EVERY,
    macs: Macs = 4,
    factor: Factor = 18,
    dsps: Dsps = 0,
    jobs: words.Jobs = 1,
    backend: OnBackend = Backend.LOKY,
    scheduler: Scheduler = None,
    as_json: Json = False,
) -> None:
    """Write the smallest design on an FPGA that meets a request.

    It tries formats, tables and architectures. A width, a number of multipliers, their factor or an architecture that
    is given is not varied. If no design meets the request, it says what binds and what is nearest, and exits with 1.
    """
    from greygate.hardware.exploring import Explorer, Unmet, facts, lines, requested, side_by_side

    given, design = _given(context), Design(multipliers=macs, factor=factor, dsps=dsps)
    wanted = _Wanted(given, network, out, record, held, width, finer, prune, weights, generic, architecture, design)
    limits = (max_error, max_latency, max_luts, max_dsps, max_memories)
    try:
        with joblib_on(backend, scheduler), following(f"compiling {network}") as progress:
            units = {port.name: port.unit for port in wanted.source.network().outputs}
            request = requested(target.value, units, *limits, **wanted.fixed())
            mapper = side_by_side(jobs if backend is Backend.LOKY else -1)
            explorer = Explorer(request, mapper, progress, wanted.source.training)
            compiled = wanted.compiled(progress, explorer=explorer)
    except Unmet as unmet:
        wanted.suppose()
        give("explored", facts(unmet.found), as_json, lines(unmet.found))
        raise typer.Exit(1) from None
    result, told = wanted.told(compiled)
    give("compile", result | {"explored": explorer.facts}, as_json, [*told[:-1], *explorer.lines, told[-1]])


def _growth(text: str | None) -> float | None:
    """The factor on the error of float. Raises InputError for another bound, which takes exploring."""
    from greygate.hardware.exploring import measured

    if text is None:
        return None
    wish = "a factor above 1 on the error of float, e.g. 1.05x; greygate explore takes other bounds"
    value, unit = measured(text, "--max-error", wish)
    if unit != "x" or value <= 1:
        raise InputError(f"--max-error {text}: give {wish}")
    return value


def _given(context: typer.Context) -> set[str]:
    """The names of the options that stand on the command line."""
    return {n for n in context.params if getattr(context.get_parameter_source(n), "name", "") == "COMMANDLINE"}


@dataclass(frozen=True)
class _Wanted:
    """What compile and explore are asked to write. given: the names of the options that stand on the command line."""

    given: set[str]
    network: str
    out: Path
    record: list[str]
    held: list[str]
    width: int
    finer: int | None
    prune: float | None
    weights: str | None
    generic: bool
    architecture: Architecture
    design: Design

    def __post_init__(self) -> None:
        """Raise InputError for options that mean nothing together."""
        concerns = {"macs": ("folded",), "factor": ("folded",), "dsps": ("parallel", "pipelined")}
        for name, those in concerns.items():
            if name in self.given and self.architecture is not EVERY and self.architecture.value not in those:
                meant = f"{self.architecture.value}, but for {' and '.join(those)}"
                raise InputError(f"--{name}: means nothing for {meant}; leave it out")

    @cached_property
    def source(self) -> "Source":
        from greygate.machines.source import Source

        return Source(self.network, recordings([*self.record, *self.held]), learnt=len(self.record) or 1)

    def fixed(self) -> dict:
        """What exploring does not vary."""
        formats = self.source.formats(self.width, self.finer)
        found: dict = {} if self.architecture is EVERY else {"architectures": (self.architecture.value,)}
        if self.given & {"width", "finer"}:
            found |= {"widths": (formats.width,), "finer": (formats.finer,)}
        found |= {"multipliers": (self.design.multipliers,)} if "macs" in self.given else {}
        return found | ({"factors": (self.design.factor,)} if "factor" in self.given else {})

    def compiled(
        self, progress: Progress, budget: float | None = None, explorer: "Explorer | None" = None
    ) -> "Compiled":
        """Write the build. budget, explorer: as for `compile_project`."""
        from greygate.project import compile_project

        return compile_project(
            self.source,
            self.out,
            self.source.formats(self.width, self.finer) if self.given & {"width", "finer"} else None,
            budget=budget,
            prune=self.prune,
            weights=self.weights,
            held=tuple(recordings(self.held)),
            generic=self.generic,
            architectures=BOTH if self.architecture is EVERY else (self.architecture.value,),
            design=self.design,
            explorer=explorer,
            progress=progress,
        )

    def suppose(self) -> None:
        if supposed := self.source.supposed:
            say(supposed)

    def told(self, compiled: "Compiled") -> tuple[dict, list[str]]:
        """What was compiled, and what it errs by beside float: as JSON, and as lines."""
        from greygate.project import fixed_and_float

        self.suppose()
        before = None if self.prune is None and self.weights is None else self.source.network()
        records = self.source.records(answering=True)
        rmse = {scenario: fixed_and_float(compiled, judged, before) for scenario, judged in records.items()}
        passes = [
            {"pass": p.name, "layers": p.layers, "parameters": p.parameters, "multiplications": p.multiplications,
             "remarks": p.remarks}
            for p in compiled.passes
        ]  # fmt: skip
        signals = {s.name: str(s.fix) for s in compiled.program.signals.values()}
        top = compiled.program.name
        result: dict = {"folder": str(self.out), "top": top, "passes": passes, "signals": signals, "rmse": rmse}
        if beside := self.source.imported:
            result["imported"] = beside
        return result, [*_steps(compiled), *_errors(rmse), f"written to {self.out}, top module {top}"]


def _steps(compiled: "Compiled") -> list[str]:
    """What each pass left, what was pruned, and what the compiler noted about single signals."""
    lines = [
        f"{p.name:18} {p.layers:4} layers {p.parameters:6} parameters {p.multiplications:6} products"
        for p in compiled.passes
    ]
    lines += [remark for p in compiled.passes for remark in p.remarks]
    for r in compiled.pruning:
        gone = ", ".join(f"{layer} {len(which)}" for layer, which in r.removed.items())
        lines.append(f"pruned {gone}: {r.neurons} neurons left, {'kept' if r.kept else 'undone'}")
    return [*lines, *(f"{name}: {why}" for name, why in compiled.program.notes.items())]


def _errors(rmse: dict) -> list[str]:
    """RMSE of the float network and of fixed point, one line for each scenario and output, in the pages' units."""
    from greygate.pages.units import display

    lines = []
    for scenario, outputs in rmse.items():
        for output, e in outputs.items():
            factor, unit = display(e["unit"], e["fixed"])
            once = f" ({factor * e['before']:.4g} before pruning)" if "before" in e else ""
            floating, fixed = (f"{factor * e[kind]:.4g}" for kind in ("float", "fixed"))
            lines.append(f"{scenario:12} {output:10} RMSE float {floating}{once}, fixed {fixed} [{unit or '1'}]")
    return lines
