"""Commands on float networks: train, compile, validate."""

import json
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from greygate.cli import options
from greygate.cli.backends import Backend, Scheduler, joblib_on
from greygate.cli.terminal import Json, finite, following, give, recordings, say
from greygate.compiler.targets import BOTH, NAMES, Design
from greygate.errors import InputError
from greygate.progress import Progress

if TYPE_CHECKING:
    from greygate.compiler.pipeline import Compiled
    from greygate.hardware.exploring import Explorer
    from greygate.machines.source import Source

_architectures = {name.upper(): name for name in (*NAMES, "both")}
Architecture = StrEnum("Architecture", _architectures)  # type: ignore[misc]  # members that NAMES lists
EVERY = Architecture("both")
OWN_TRAINING = (  # options of a user's network
    *("tail", "narx", "epochs", "decay", "settle", "shooting", "seconds"),
    *("seeds", "jobs", "offset", "gain", "html"),
)


def catalogued(begun: str) -> list[str]:
    """For the shell's completion: names of the catalogue that begin so; if there are none, it completes files."""
    from greygate.machines.catalog import CATALOG

    return [name for name in CATALOG if name.startswith(begun)]


Network = Annotated[
    str, typer.Argument(help="A name of the catalogue, or NAME.toml with --record.", autocompletion=catalogued)
]
Settle = Annotated[
    int, typer.Option(callback=options.SAMPLES, help="First samples of each record: they give only its initial state.")
]


def train(
    context: typer.Context,
    name: Annotated[
        str,
        typer.Argument(
            help="A network of the catalogue, `list`, or NAME.toml with --record.", autocompletion=catalogued
        ),
    ],
    record: Annotated[list[str], typer.Option(help="FILE.csv to train on; several may be given.")] = [],
    held: Annotated[list[str], typer.Option(help="FILE.csv that is not trained on: it chooses the epoch.")] = [],
    tail: Annotated[
        float, typer.Option(callback=options.SHARE, help="Share at the end of each record that chooses the epoch.")
    ] = 0.0,
    narx: Annotated[bool, typer.Option(help="Train the one-step prediction first, then the free run.")] = True,
    epochs: Annotated[int, typer.Option(callback=options.COUNT, help="Most epochs of training in free run.")] = 200,
    decay: Annotated[float, typer.Option(callback=options.DECAY, help="Weight decay D of the loss.")] = 0.0,
    settle: Annotated[
        str, typer.Option(help="First samples of each record that give only its initial state; auto finds how many.")
    ] = "0",
    shooting: Annotated[
        int | None, typer.Option(callback=options.COUNT, help="Multiple shooting, in windows of this many samples.")
    ] = None,
    offset: Annotated[
        list[str], typer.Option(help="Output whose sensor has an offset of its own in each recording but the first.")
    ] = [],
    gain: Annotated[
        list[str], typer.Option(help="Output whose sensor has a gain of its own in each recording but the first.")
    ] = [],
    seeds: Annotated[
        int, typer.Option(callback=options.STARTS, help="Starts: the file's weights, and others that are drawn.")
    ] = 1,
    jobs: Annotated[int, typer.Option(callback=options.JOBS, help="Starts side by side.")] = 2,
    seconds: Annotated[float, typer.Option(callback=options.SECONDS, help="Time limit of all starts.")] = float("inf"),
    out: Annotated[Path | None, typer.Option(help="Folder for NAME.toml, .safetensors, .json.")] = None,
    html: Annotated[Path | None, typer.Option(help="HTML page to write: curves, weights, poles, residuals.")] = None,
    as_json: Json = False,
) -> None:
    """Train a network by Levenberg-Marquardt: one of the catalogue from scratch, or your own on your recordings.

    If training your own network was interrupted, it resumes from OUT/NAME.checkpoint. Exit code 1 if the free run of
    your network diverges.
    """
    from greygate.machines.catalog import CATALOG

    if name == "list":
        give(
            "catalogue",
            {n: e.title for n, e in CATALOG.items()},
            as_json,
            [f"{n:20} {e.title}" for n, e in CATALOG.items()],
        )
    elif name not in CATALOG and (record or name.endswith(".toml")):
        how = {"narx": narx, "tail": tail, "epochs": epochs, "decay": decay, "shooting": shooting, "seconds": seconds}
        _train_own(
            name,
            record,
            held,
            settle,
            how | {"seeds": seeds, "jobs": jobs, "offset": offset, "gain": gain, "html": html},
            out,
            as_json,
        )
    else:
        if record or held:
            raise InputError(f"{name} is trained on its own records; give --record only with a NAME.toml file")
        sources = {n: context.get_parameter_source(n) for n in OWN_TRAINING}
        if given := [f"--{n}" for n, s in sources.items() if s is not None and s.name == "COMMANDLINE"]:
            raise InputError(f"{name} is trained with its own options; give {', '.join(given)} with a NAME.toml file")
        _train_stored(name, out, as_json)


def _train_stored(name: str, out: Path | None, as_json: bool) -> None:
    """Train a network of the catalogue."""
    from greygate.machines.catalog import entry

    chosen = entry(name)
    if not out:
        raise InputError("--out is missing; give the folder to write the trained network to, such as --out .")
    if not out.is_dir():
        raise InputError(f"{out}: no such folder; make it")
    with following(f"training {name}") as progress:
        network, figures = chosen.train(progress)
    chosen.save(network, figures, out)
    give("catalogue-training", figures, as_json, [json.dumps(figures, indent=1), f"written to {out / name}.toml"])


def _train_own(
    network: str, record: list[str], held: list[str], settle: str, how: dict, out: Path | None, as_json: bool
) -> None:
    """Train a user's network."""
    from dataclasses import replace

    from greygate.identify.training import table, train_records
    from greygate.machines.source import Source
    from greygate.pages.summary import aligned
    from greygate.pages.training import page

    if not out:
        raise InputError("--out is missing; give the folder to write the trained network to")
    how |= {"settle": _settle(settle), "page": page}
    source, others = Source(network, recordings(record)), recordings(held)
    with following(f"training {Path(network).stem}") as progress:
        records, judges = source.apart(others)
        start = replace(source.network(), dt=source.period)
        trained = train_records(start, records, judges, out, progress=progress, **how)
    for remark in trained["remarks"]:
        say(remark)
    lines = []
    for name, errors in trained["rmse"].items():
        for port, error in errors.items():
            beside = f" (linear {finite(trained['linear'][name][port], '.4g')})" if name in trained["linear"] else ""
            lines.append(f"{name:12} {port:10} RMSE {finite(error, '.4g')}{beside}")
    for name, offsets in trained["offsets"].items():
        lines += [f"{name:12} {port:10} offset {value:.4g}, taken off" for port, value in offsets.items()]
    for name, gains in trained["gains"].items():
        lines += [f"{name:12} {port:10} gain {value:.4g}, divided by" for port, value in gains.items()]
    head = f"{trained['epochs']} epochs. {trained['sentence']}"
    if len(trained["starts"]) > 1:
        lines += [*aligned(table(trained["starts"]), ("start", "outcome")), "* chosen by what was held out, normalised"]
    lines += [f"written to {path}" for path in (trained["out"], how["html"]) if path is not None]
    give("train", trained, as_json, [head, *lines])
    if trained["outcome"] == "diverged":
        raise typer.Exit(1)


def _settle(text: str) -> int | None:
    """Samples; None where they are to be found. Raises InputError for another text."""
    from greygate.identify.settling import AUTO

    if text == AUTO:
        return None
    if not (text.isascii() and text.isdigit() and len(text) < 10):
        raise InputError(f"--settle {text}: give a whole number of samples from 0 to {options.MOST}, or {AUTO}")
    return int(text)


def compile(
    context: typer.Context,
    network: Network,
    out: Annotated[Path, typer.Option(help="Folder to write; replaced if it is an earlier compilation.")],
    record: Annotated[list[str], typer.Option(help="FILE.csv or SCENARIO=FILE.csv; the first sets the ranges.")] = [],
    held: Annotated[
        list[str], typer.Option(help="FILE.csv that bounds the error of pruning, instead of the first.")
    ] = [],
    width: Annotated[
        int, typer.Option(callback=options.WIDTH, help="Word width of signals and weights, 4 to 32 bits.")
    ] = 16,
    finer: Annotated[
        int | None,
        typer.Option(
            callback=options.FINER,
            help="Bits that weights and neurons have beyond the width; if not given, the catalogue's choice, else 0.",
        ),
    ] = None,
    budget: Annotated[
        float | None,
        typer.Option(callback=options.GROWTH, help="Instead of a width: largest RMSE, as a factor of float's."),
    ] = None,
    prune: Annotated[
        float | None, typer.Option(callback=options.ALLOWANCE, help="Entropy pruning; RMSE may grow by this factor.")
    ] = None,
    weights: Annotated[
        str | None, typer.Option(help="Then prune single weights: obs, obd, magnitude, multi_obs, unit_obs, ...")
    ] = None,
    generic: Annotated[bool, typer.Option(help="Merge linear layers even where that costs multipliers.")] = False,
    architecture: Annotated[Architecture, typer.Option()] = EVERY,
    macs: Annotated[int, typer.Option(callback=options.MACS, help="Multipliers of the folded architecture.")] = 4,
    factor: Annotated[
        int, typer.Option(callback=options.FACTOR, help="Bits of their widest factor; an iCE40 has 16 in one DSP.")
    ] = 18,
    dsps: Annotated[
        int,
        typer.Option(callback=options.DSPS, help="Tables of the parallel one that multiply in a DSP."),
    ] = 0,
    device: Annotated[
        str | None, typer.Option(help="FPGA such as up5k: explore, and write the smallest design that meets --max-...")
    ] = None,
    max_error: Annotated[
        str | None, typer.Option(help="Error beside float: 0.5% of an output's range, 0.2bar, or 1.05x its RMSE.")
    ] = None,
    max_latency: Annotated[str | None, typer.Option(help="Time of a step, such as 2us.")] = None,
    max_luts: Annotated[int | None, typer.Option(callback=options.LUTS, help="LUTs.")] = None,
    max_dsps: Annotated[int | None, typer.Option(callback=options.DSPS, help="DSPs.")] = None,
    max_memories: Annotated[float | None, typer.Option(callback=options.MEMORIES, help="Blocks of memory.")] = None,
    jobs: Annotated[
        int, typer.Option(callback=options.JOBS, help="Processes that explore; dask uses all its workers.")
    ] = 1,
    backend: Annotated[
        Backend, typer.Option(help="Explore in processes of this computer, or on a cluster.")
    ] = Backend.LOKY,
    scheduler: Scheduler = None,
    as_json: Json = False,
) -> None:
    """Simplify, prune and quantize a network, and write it as Verilog.

    With --device it tries formats, tables and architectures, and writes the smallest design that meets the request; if
    there is none it says what binds and what is nearest, and exits with 1. A width, a number of multipliers,
    their factor or an architecture that is given is not varied.
    """
    from greygate.hardware.exploring import Unmet, facts, lines
    from greygate.machines.source import Source
    from greygate.project import compile_project, fixed_and_float

    found = None
    given = {n for n in context.params if getattr(context.get_parameter_source(n), "name", "") == "COMMANDLINE"}
    _check_exploring(given)
    _check_design(given, architecture)
    pruned = prune is not None or weights is not None
    if held and not pruned:
        raise InputError("--held: it only bounds pruning; give --prune or --weights, or give the file as --record")
    chosen = BOTH if architecture is EVERY else (architecture.value,)
    judges = recordings(held)
    source = Source(network, recordings([*record, *held]))
    formats = source.formats(width, finer)
    tried: dict = {} if architecture is EVERY else {"architectures": chosen}
    if given & {"width", "finer"}:
        tried |= {"widths": (formats.width,), "finer": (formats.finer,)}
    if "macs" in given:
        tried["multipliers"] = (macs,)
    if "factor" in given:
        tried["factors"] = (factor,)
    limits = (max_error, max_latency, max_luts, max_dsps, max_memories)
    with joblib_on(backend, scheduler), following(f"compiling {network}") as progress:
        explorer = _explorer(source, device, limits, tried, jobs if backend is Backend.LOKY else -1, progress)
        try:
            compiled = compile_project(
                source,
                out,
                formats if given & {"width", "finer"} else None,
                budget=budget,
                prune=prune,
                weights=weights,
                held=tuple(judges),
                generic=generic,
                architectures=chosen,
                design=Design(multipliers=macs, factor=factor, dsps=dsps),
                explorer=explorer,
                progress=progress,
            )
        except Unmet as unmet:
            found = unmet.found
    if supposed := source.supposed:
        say(supposed)
    if found is not None:
        give("explored", facts(found), as_json, lines(found))
        raise typer.Exit(1)
    before = source.network() if pruned else None
    rmse = {scenario: fixed_and_float(compiled, judged, before) for scenario, judged in source.records().items()}
    passes = [
        {"pass": p.name, "layers": p.layers, "parameters": p.parameters, "multiplications": p.multiplications,
         "remarks": p.remarks}
        for p in compiled.passes
    ]  # fmt: skip
    signals = {s.name: str(s.fix) for s in compiled.program.signals.values()}
    top = compiled.program.name
    result = {"folder": str(out), "top": top, "passes": passes, "signals": signals, "rmse": rmse}
    told = [*_steps(compiled), *_errors(rmse)]
    if explorer:
        result["explored"] = explorer.facts
        told += explorer.lines
    give("compile", result, as_json, [*told, f"written to {out}, top module {top}"])


def _check_design(given: set[str], architecture: Architecture) -> None:
    """Raise InputError for an option of an architecture that is not written."""
    concerns = {"macs": ("folded",), "factor": ("folded",), "dsps": ("parallel", "pipelined")}
    for name, those in concerns.items():
        if name in given and architecture is not EVERY and architecture.value not in those:
            meant = " and ".join(those)
            raise InputError(f"--{name}: means nothing for {architecture.value}, but for {meant}; leave it out")


def _check_exploring(given: set[str]) -> None:
    """Raise InputError for options that mean nothing together."""
    limits = ("max_error", "max_latency", "max_luts", "max_dsps", "max_memories", "jobs", "backend", "scheduler")
    for name in ("budget",) if "device" in given else limits:
        if name in given:
            does = "does not go with --device; give --max-error" if "device" in given else "needs --device"
            raise InputError(f"--{name.replace('_', '-')} {does}")


def _explorer(
    source: "Source", device: str | None, limits: tuple, tried: dict, jobs: int, progress: Progress
) -> "Explorer | None":
    """What answers the request of the options; None if no device is named."""
    if device is None:
        return None
    from greygate.hardware.exploring import Explorer, requested, side_by_side

    units = {port.name: port.unit for port in source.network().outputs}
    asked = requested(device, units, *limits, **tried)
    return Explorer(asked, side_by_side(jobs), progress, source.training)


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


def validate(
    network: Network,
    record: Annotated[list[str], typer.Option(help="FILE.csv or SCENARIO=FILE.csv; the first was trained on.")] = [],
    out: Annotated[Path, typer.Option(help="HTML page to write.")] = Path("validation.html"),
    lags: Annotated[
        int, typer.Option(callback=options.COUNT, help="Largest lag of the residual tests, in steps.")
    ] = 25,
    settle: Settle = 0,
    as_json: Json = False,
) -> None:
    """Judge a float network by free run, k-step prediction, residual tests and long run: a table and one HTML page.

    Exit code 1 if a free run is unbounded.
    """
    from greygate.machines.source import Source
    from greygate.pages import templates
    from greygate.pages.validation import page
    from greygate.pages.validation.advice import advice
    from greygate.pages.validation.judged import judge, table

    source = Source(network, recordings(record), settle)
    with following(f"validating {network}") as progress:
        judged = judge(source, lags, progress)
        templates.write(page(judged), out)
    if supposed := source.supposed:
        say(supposed)
    told = advice(judged)
    give("validate", judged.figures() | {"advice": told}, as_json, [*table(judged), *told, f"written to {out}"])
    if not judged.bounded:
        raise typer.Exit(1)
