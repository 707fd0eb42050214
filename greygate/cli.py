"""The command line. Results go to stdout, messages to stderr; exit 0 done, 1 the answer is no, 2 wrong use."""

import io
import json
import os
import re
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from greygate import __version__, options
from greygate.errors import InputError, one_line
from greygate.names import check_text

app = typer.Typer(
    help="Grey-box networks from a mechanical plant to an FPGA.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


class Architecture(StrEnum):
    PARALLEL = "parallel"
    FOLDED = "folded"
    BOTH = "both"


class Target(StrEnum):
    ECP5 = "ecp5"
    ICE40 = "ice40"
    XILINX = "xilinx"


class Backend(StrEnum):
    LOKY = "loky"
    DASK = "dask"


INTERRUPTED, TERMINATED = 130, 143  # exit codes of what Ctrl-C, and what `kill` ends, as shells have them
UsageError = typer.BadParameter.__base__  # of whatever a command line lacks or has too much
REACHED = 10.0  # s in which a cluster's scheduler answers

OWN_TRAINING = ("tail", "narx", "epochs", "decay", "settle", "shooting", "seconds")  # options of a user's network

Tables = Annotated[list[Path], typer.Option(help="TOML file that extends the effects; hydraulics comes along.")]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
Folder = Annotated[Path, typer.Argument(help="A folder that `greygate compile` wrote.")]


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"greygate {__version__}")
        raise typer.Exit()


@app.callback()
def main(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and stop.")
    ] = False,
) -> None:
    pass


def _give(result: dict, as_json: bool, lines: list[str]) -> None:
    _print(json.dumps(result, indent=1) if as_json else "\n".join(lines))


def _print(text: str) -> None:
    try:
        typer.echo(text)
    except BrokenPipeError:  # `| head` has read enough; what is left goes nowhere
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _say(text: str) -> None:
    """One line on stderr, whatever the text holds."""
    typer.echo(one_line(" ".join(text.split())), err=True)


def _finite(value: float | None, form: str) -> str:
    """A number as JSON has it, which knows no infinity."""
    return "inf" if value is None else f"{value:{form}}"


@contextmanager
def _progress(title: str) -> Iterator:
    """A line on stderr that follows long work; gives a function that takes what is being done."""
    from rich.console import Console

    console = Console(stderr=True)
    with console.status(title) as status:
        yield lambda *parts: status.update(f"{title}: {' '.join(str(p) for p in parts)}")


@contextmanager
def _bar(title: str, total: int) -> Iterator:
    """A bar on stderr; gives a function that takes how far the work is and a word on it."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        TextColumn(title),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.fields[word]}"),
    )
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(title, total=total, word="")
        yield lambda done, word: bar.update(task, completed=done, word=word)


@app.command()
def train(
    context: typer.Context,
    name: Annotated[str, typer.Argument(help="A network of the catalogue, `list`, or NAME.toml with --record.")],
    record: Annotated[list[str], typer.Option(help="FILE.csv to learn from; several may be given.")] = [],
    held: Annotated[list[str], typer.Option(help="FILE.csv that only chooses the epoch.")] = [],
    tail: Annotated[
        float, typer.Option(callback=options.SHARE, help="Share at the end of each record that only chooses the epoch.")
    ] = 0.0,
    narx: Annotated[bool, typer.Option(help="Learn one step ahead first, then free run from there.")] = True,
    epochs: Annotated[int, typer.Option(callback=options.COUNT, help="Of the free run, at most.")] = 200,
    decay: Annotated[float, typer.Option(callback=options.DECAY, help="Weight decay D of the loss.")] = 0.0,
    settle: Annotated[
        int,
        typer.Option(callback=options.SAMPLES, help="First samples of each record that only tell its initial state."),
    ] = 0,
    shooting: Annotated[
        int | None, typer.Option(callback=options.COUNT, help="Multiple shooting in windows of so many samples.")
    ] = None,
    seconds: Annotated[float, typer.Option(callback=options.SECONDS, help="Time limit.")] = float("inf"),
    out: Annotated[Path | None, typer.Option(help="Folder for NAME.toml, .safetensors, .json.")] = None,
    as_json: Json = False,
) -> None:
    """Train a network by Levenberg-Marquardt: one of the catalogue from nothing, or your own on your recordings.

    Your own is resumed from OUT/NAME.checkpoint if it was interrupted. Exit code 1 if its free run diverges.
    """
    from greygate.machines.catalog import CATALOG, entry
    from greygate.machines.identification import TRAINED

    if name == "list":
        _give({n: e.title for n, e in CATALOG.items()}, as_json, [f"{n:20} {e.title}" for n, e in CATALOG.items()])
        return
    if name not in CATALOG and (record or name.endswith(".toml")):
        how = {"tail": tail, "epochs": epochs, "decay": decay, "shooting": shooting, "seconds": seconds}
        _train_own(name, record, held, settle, narx, how, out, as_json)
        return
    chosen, out = entry(name), out or TRAINED
    if record or held:
        raise InputError(f"{name} is trained on records of its own; --record goes with a NAME.toml file")
    if given := [f"--{n}" for n in OWN_TRAINING if context.get_parameter_source(n).name == "COMMANDLINE"]:
        raise InputError(f"{name} is trained in a way of its own; {', '.join(given)} goes with a NAME.toml file")
    if not out.is_dir():
        raise InputError(f"{out}: no such folder; make it, or leave --out away to write into the package")
    with _progress(f"training {name}") as follow:
        network, figures = chosen.train(follow)
    chosen.save(network, figures, out)
    _give(figures, as_json, [json.dumps(figures, indent=1), f"written to {out / name}.toml"])


def _train_own(name, record, held, settle, narx, how, out, as_json) -> None:
    from greygate.project import Source, train_source

    if not out:
        raise InputError("--out is missing: the folder that the trained network is written into")
    source = Source(name, _recordings([_named(text) for text in record]), settle)
    others = _recordings([_named(text) for text in held])
    with _bar(f"training {Path(name).stem}", how["epochs"]) as follow:
        trained = train_source(source, out, others, narx=narx, progress=follow, **how)
    for remark in trained["remarks"]:
        _say(remark)
    lines = [
        f"{r:12} {o:10} RMSE {_finite(e, '.4g')}" for r, errors in trained["rmse"].items() for o, e in errors.items()
    ]
    _give(
        trained, as_json, [f"{trained['epochs']} epochs. {trained['sentence']}", *lines, f"written to {trained['out']}"]
    )
    if trained["outcome"] == "diverged":
        raise typer.Exit(1)


def _named(text: str) -> str:
    """SCENARIO=FILE.csv; a file alone is called by its name."""
    return text if "=" in text else f"{Path(text).stem}={text}"


def _recordings(given: list[str]) -> dict[str, str]:
    found = {}
    for text in given:
        scenario, equals, path = text.partition("=")
        if not equals or not scenario:
            raise InputError(f"--record {text}: write SCENARIO=FILE.csv, e.g. training=train.csv")
        check_text(scenario, "--record, scenario")
        if scenario in found:
            raise InputError(f"--record {text}: the scenario {scenario} is given twice; name one otherwise")
        found[scenario] = path
    return found


@app.command()
def compile(
    network: Annotated[str, typer.Argument(help="A name of the catalogue, or NAME.toml with --record.")],
    out: Annotated[Path, typer.Option(help="Folder to write; replaced if it is an earlier compilation.")],
    record: Annotated[list[str], typer.Option(help="FILE.csv or SCENARIO=FILE.csv; the first sets the ranges.")] = [],
    held: Annotated[list[str], typer.Option(help="FILE.csv on which, not on the first, pruning is judged.")] = [],
    width: Annotated[
        int, typer.Option(callback=options.WIDTH, help="Word width of signals and weights, 4 to 32 bits.")
    ] = 16,
    finer: Annotated[
        int | None,
        typer.Option(
            callback=options.FINER,
            help="Bits more for weights and neurons; the catalogue's choice if not given, else 0.",
        ),
    ] = None,
    budget: Annotated[
        float | None,
        typer.Option(callback=options.GROWTH, help="Instead of a width: RMSE may be so many times float's."),
    ] = None,
    prune: Annotated[
        float | None, typer.Option(callback=options.ALLOWANCE, help="Entropy pruning; RMSE may grow by this factor.")
    ] = None,
    weights: Annotated[
        str | None, typer.Option(help="Then prune single weights: obs, obd, magnitude, multi_obs, unit_obs, ...")
    ] = None,
    generic: Annotated[bool, typer.Option(help="Merge linear layers even where that costs multipliers.")] = False,
    architecture: Annotated[Architecture, typer.Option()] = Architecture.BOTH,
    macs: Annotated[int, typer.Option(callback=options.MACS, help="Multipliers of the folded architecture.")] = 4,
    as_json: Json = False,
) -> None:
    """Simplify, prune, quantize a network and write it as Verilog."""
    from greygate.project import ARCHITECTURES, Source, compile_project, fixed_and_float

    pruned = prune is not None or weights is not None
    if held and not pruned:
        raise InputError("--held: judges pruning; give --prune or --weights, or name it with --record")
    chosen = ARCHITECTURES if architecture is Architecture.BOTH else (architecture.value,)
    judges = _recordings([_named(text) for text in held])
    source = Source(network, _recordings([_named(text) for text in (*record, *held)]))
    with _progress(f"compiling {network}") as follow:
        compiled = compile_project(
            source,
            out,
            source.formats(width, finer),
            budget=budget,
            prune=prune,
            weights=weights,
            held=tuple(judges),
            generic=generic,
            architectures=chosen,
            macs=macs,
            progress=follow,
        )
    passes = [
        {"pass": p.name, "layers": p.layers, "parameters": p.parameters, "multiplications": p.multiplications,
         "remarks": p.remarks}
        for p in compiled.passes
    ]  # fmt: skip
    signals = {s.name: str(s.fix) for s in compiled.program.signals.values()}
    lines = [f"{p['pass']:18} {p['layers']:4} layers {p['parameters']:6} parameters {p['multiplications']:6} products"
             for p in passes]  # fmt: skip
    lines += [remark for p in passes for remark in p["remarks"]]
    for r in compiled.pruning:
        gone = ", ".join(f"{layer} {len(which)}" for layer, which in r.removed.items())
        lines.append(f"pruned {gone}: {r.neurons} neurons left, {'kept' if r.kept else 'undone'}")
    lines += [f"{name}: {why}" for name, why in compiled.program.notes.items()]
    rmse = {}
    before = source.network() if pruned else None
    for scenario, judged in source.records().items():
        rmse[scenario] = found = fixed_and_float(compiled, judged, before)
        for output, e in found.items():
            once = f" ({e['before']:.4g} before pruning)" if pruned else ""
            lines.append(
                f"{scenario:12} {output:10} RMSE float {e['float']:.4g}{once}, fixed {e['fixed']:.4g} [{e['unit']}]"
            )
    lines += [f"written to {out}, top module {compiled.program.name}"]
    result = {"folder": str(out), "top": compiled.program.name, "passes": passes, "signals": signals, "rmse": rmse}
    _give(result, as_json, lines)


@app.command()
def emulate(
    folder: Folder,
    recording: Annotated[Path, typer.Argument(help="CSV with a column `name_unit` for every input.")],
    out: Annotated[Path, typer.Option(help="CSV to write the predicted outputs to.")],
    as_json: Json = False,
) -> None:
    """Run the compiled network, bit for bit as the hardware does, over a recording."""
    from greygate.emulator.engine import run
    from greygate.plants.recording import Recording, read_csv
    from greygate.project import Project, read_record

    project = Project.open(folder)
    record = read_record(project.network, recording, targets=False)
    answer = run(project.program, project.program.encode(record.inputs), states=False)
    channels = project.program.decode(answer.outputs)
    units = {p.name: p.unit for p in project.program.outputs}
    Recording(read_csv(recording).dt, channels, units).write_csv(out)
    saturations = {name: n for name, n in answer.saturations.items() if n}
    clipped = project.program.clipped(record.inputs)
    counted = f"saturations {saturations or 'none'}, clipped inputs {len(clipped) or 'none'}"
    lines = [f"{len(answer.outputs)} steps, {counted}"]
    for port in (p for p in project.program.inputs if p.name in clipped):
        found = clipped[port.name]
        holds, given = (f"{least:.6g} to {most:.6g} {port.unit}" for least, most in (found.holds, found.given))
        share = f"{found.count} samples ({found.share:.2%})"
        lines.append(f"input {port.name}: {share} clipped to {holds}, which {port.signal.fix} holds; given {given}")
    result = {"steps": len(answer.outputs), "saturations": saturations}
    result |= {"clipped": {name: found._asdict() for name, found in clipped.items()}, "out": str(out)}
    _give(result, as_json, [*lines, f"written to {out}"])


@app.command()
def verify(
    folder: Folder,
    scenario: Annotated[list[str], typer.Option(help="Only these scenarios.")] = [],
    seed: Annotated[
        int | None,
        typer.Option(callback=options.SEED, help="Of back-pressure and reset; drawn and printed if not given."),
    ] = None,
    as_is: Annotated[bool, typer.Option("--as-is", help="Even Verilog that was changed; it is code, read it.")] = False,
    as_json: Json = False,
) -> None:
    """Simulate the emitted Verilog in Verilator and compare every output and every state with the emulator.

    Exit code 1 if a bit differs; results-ARCHITECTURE.xml in the folder is JUnit.
    """
    from greygate.project import Project, verify_project

    project = Project.open(folder)
    with _progress(f"simulating {project.program.name}"):
        results = verify_project(project, tuple(scenario), seed, as_is)
    verdicts = [v for r in results.values() for v in r.verdicts]
    lines = [
        f"{v.program} {v.architecture:9} {v.scenario:12} {v.steps:6} steps, {v.clocks_per_step:6.1f} clocks a step: "
        + (v.mismatch or "every bit of every output and state equal")
        for v in verdicts
    ]
    found = [vars(v) for v in verdicts]
    _give({"passed": all(r.passed for r in results.values()), "verdicts": found}, as_json, lines)
    if not all(r.passed for r in results.values()):
        raise typer.Exit(1)


@app.command()
def synthesize(
    folder: Folder,
    target: Annotated[Target, typer.Option()] = Target.ECP5,
    clock: Annotated[bool, typer.Option(help="Place and route with nextpnr for the clock rate (ECP5).")] = False,
    limit: Annotated[
        float | None, typer.Option(callback=options.SECONDS, help="Stop each design's tools after so many CPU seconds.")
    ] = None,
    keep: Annotated[bool, typer.Option(help="Keep the figures in the package, for `report --all`.")] = False,
    as_json: Json = False,
) -> None:
    """Count LUTs, flip-flops, DSPs and block RAM with Yosys. Slow: minutes."""
    from greygate.project import Project, synthesize_project

    project = Project.open(folder)
    with _progress(f"synthesizing {project.program.name} for {target.value}"):
        found = synthesize_project(project, target.value, clock, limit, keep)
    lines = [f"{name}: " + ", ".join(f"{k} {v}" for k, v in figures.items()) for name, figures in found.items()]
    _give(found, as_json, lines)


@app.command()
def report(
    folders: Annotated[list[Path], typer.Argument(help="Folders that `greygate compile` wrote.")] = [],
    every: Annotated[
        bool,
        typer.Option("--all", help="The thesis's plants side by side, from FOLDER/NAME; compiled if need be."),
    ] = False,
    check: Annotated[bool, typer.Option("--verify", help="Verify first what has not been verified.")] = False,
    out: Annotated[Path, typer.Option(help="HTML page to write; the JSON goes beside it.")] = Path("report.html"),
    as_json: Json = False,
) -> None:
    """What quantization cost, per plant and scenario, as one HTML page and one JSON.

    With --all one FOLDER, `hardware` if none is given. Exit code 1 if --verify finds a differing bit.
    """
    from greygate.pages.report import write
    from greygate.pages.summary import WIDTHS, aligned, designs, results
    from greygate.project import Project, plants, study_project, verify_project

    if every and len(folders) > 1:
        raise InputError(f"--all takes one folder that holds a folder for each plant, not {len(folders)}")
    if not every and not folders:
        raise InputError("report: give folders that `greygate compile` wrote, or --all")
    if not out.name or out.suffix == ".json":
        raise InputError(f"--out {out}: name an HTML page, such as report.html; the JSON beside it ends in .json")
    passed = True
    with _progress("measuring") as follow:
        projects = plants((folders or [Path("hardware")])[0], follow) if every else [Project.open(f) for f in folders]
        for project in projects if check else ():
            if project.hardware is None:
                follow(f"simulating {project.program.name}")
                passed &= all(result.passed for result in verify_project(project).values())
        studies = [study_project(project, follow, **{"widths": WIDTHS} if every else {}) for project in projects]
    tables = [results(studies), designs(studies)] if every else []
    write(studies, out, out.with_suffix(".json"), tables)
    if as_json:
        _print(out.with_suffix(".json").read_text())
    else:
        lines = [line for table in tables for line in (*aligned(table), "")] or _errors(studies)
        _print("\n".join([*lines, f"written to {out} and {out.with_suffix('.json')}"]))
    if not passed:
        raise typer.Exit(1)


def _errors(studies: list[dict]) -> list[str]:
    """RMSE of float and fixed, a line for each plant, scenario and output."""
    from greygate.pages.report import display

    lines = []
    for study in studies:
        lines.append(study["title"])
        for name, scenario in study["scenarios"].items():
            for label, figures in scenario["outputs"].items():
                factor, unit = display(figures["unit"])
                float_, fixed = (factor * figures["rmse"][kind] for kind in ("float", "fixed"))
                lines.append(f"  {name:10} {label:8} RMSE float {float_:8.4g} {unit}, fixed {fixed:8.4g} {unit}")
    return lines


@app.command()
def validate(
    network: Annotated[str, typer.Argument(help="A name of the catalogue, or NAME.toml with --record.")],
    record: Annotated[list[str], typer.Option(help="FILE.csv or SCENARIO=FILE.csv; the first was learnt from.")] = [],
    out: Annotated[Path, typer.Option(help="HTML page to write.")] = Path("validation.html"),
    lags: Annotated[int, typer.Option(callback=options.COUNT, help="Of the residual tests, in steps.")] = 25,
    settle: Annotated[
        int,
        typer.Option(callback=options.SAMPLES, help="First samples of each record that only tell its initial state."),
    ] = 0,
    as_json: Json = False,
) -> None:
    """Free run, steps ahead, residual tests and long run of a float network, as a table and one HTML page.

    Exit code 1 if a free run is unbounded.
    """
    from greygate.pages.validation import judge, table, write
    from greygate.project import Source

    with _progress(f"validating {network}") as follow:
        judged = judge(Source(network, _recordings([_named(text) for text in record]), settle), lags, follow)
        write(judged, out)
    _give(judged.figures(), as_json, [*table(judged), f"written to {out}"])
    if not judged.bounded:
        raise typer.Exit(1)


@app.command()
def diagnose(
    rigs: Annotated[list[Path], typer.Argument(metavar="RIG_FOLDER...", help="Folders of rig.toml, identify.csv.")],
    out: Annotated[
        Path | None, typer.Option(help="diagnosis.json to write; of several rigs a folder of NAME.json.")
    ] = None,
    html: Annotated[
        Path | None, typer.Option(help="Page that argues the case; of several rigs a folder of NAME.html.")
    ] = None,
    effects: Tables = [],
    jobs: Annotated[
        int, typer.Option(callback=options.JOBS, help="Rigs diagnosed at a time; dask takes all its workers.")
    ] = 1,
    backend: Annotated[Backend, typer.Option(help="Processes of this machine, or a cluster.")] = Backend.LOKY,
    scheduler: Annotated[str | None, typer.Option(help="Of the dask cluster: tcp://HOST:PORT.")] = None,
    as_json: Json = False,
) -> None:
    """Say where a simulation and a recording differ, what physics is left out, and how much better it fits with it.

    The files: docs/diagnosis.md. Exit code 0 whatever the verdict; of several rigs one that cannot be diagnosed is
    told, the others are written, and the exit code is 2.
    """
    from greygate.diagnose import explain, explain_all

    if len(rigs) == 1 and backend is Backend.LOKY and scheduler is None:
        with _bar("diagnosing", 100) as follow:
            found, lines = explain(rigs[0], out, html, effects, lambda text, share: follow(round(100 * share), text))
        failed = []
    else:
        with _joblib(backend, scheduler), _bar("diagnosing", len(rigs)) as follow:
            results = explain_all(rigs, out, html, effects, jobs, follow)
        found = {name: content for name, (content, _) in results.items()}
        failed = [name for name, content in found.items() if "error" in content]
        found = found if len(rigs) > 1 else next(iter(found.values()))
        lines = [line for _, text in results.values() for line in (*text, "")][:-1]
    lines += [f"written to {path}" for path in (out, html) if path is not None]
    _give(found, as_json, lines)
    for name in failed:
        _say(f"greygate: {name}: {found[name]['error']}")
    if failed:
        raise typer.Exit(2)


@contextmanager
def _joblib(backend: Backend, scheduler: str | None) -> Iterator[None]:
    """Have joblib run its tasks there. Raises InputError where the cluster cannot be had."""
    import joblib

    if backend is Backend.LOKY:
        if scheduler is not None:
            raise InputError("--scheduler: the processes of this machine have none; add --backend dask")
        yield
        return
    try:
        from distributed import Client
    except ImportError:
        raise InputError("--backend dask: distributed is not installed; pip install 'greygate[cluster]'") from None
    if not re.fullmatch(r"(\w+://)?[^/]+:\d+", scheduler or ""):
        raise InputError(f"--scheduler {scheduler}: give the address of the cluster's scheduler, tcp://HOST:PORT")
    try:
        client = Client(scheduler, timeout=REACHED, set_as_default=False)
    except (OSError, TimeoutError) as error:
        raise InputError(f"--scheduler {scheduler}: no answer ({error}); start `dask scheduler` there") from None
    with client, joblib.parallel_config(backend="dask", client=client):
        yield


Rig = Annotated[Path, typer.Argument(metavar="RIG_FOLDER", help="Folder of rig.toml.")]


@app.command()
def isolability(
    rig: Rig,
    effects: Tables = [],
    ranges: Annotated[
        list[str], typer.Option("--range", help="NAME=LOW:HIGH of every input: motions by rule, before data.")
    ] = [],
    as_json: Json = False,
) -> None:
    """Say which effects a rig's sensors and its identify.csv cannot tell apart, and which experiment or sensor would.

    Without identify.csv, what motions within the inputs' ranges could tell.
    """
    from greygate.diagnose import isolable

    spans = [_range(text) for text in ranges]
    if len(dict(spans)) < len(spans):
        raise InputError(f"--range {' '.join(ranges)}: one input is given twice; give one range of each")
    with _progress("simulating"):
        found, lines = isolable(rig, effects, dict(spans))
    _give(found, as_json, lines)


def _range(text: str) -> tuple[str, tuple[float, float]]:
    name, _, span = text.partition("=")
    low, _, high = span.partition(":")
    try:
        return name, (float(low), float(high))
    except ValueError:
        raise InputError(f"--range {text}: give NAME=LOW:HIGH, in the input's unit") from None


@app.command()
def simulate(
    rig: Rig,
    recording: Annotated[Path, typer.Option(help="CSV of this rig: inputs, and the states that runs begin from.")],
    out: Annotated[Path, typer.Option(help="CSV to write: t and the predicted channels.")],
    diagnosis: Annotated[Path | None, typer.Option(help="Of this plant: the simulation as it corrects it.")] = None,
    effects: Annotated[list[Path], typer.Option(help="Tables that the diagnosis had, too.")] = [],
    as_json: Json = False,
) -> None:
    """Simulate a recording with the data sheet's values, or as a diagnosis corrects the plant.

    Exit code 1 if the simulation diverges; what it wrote ends in nan.
    """
    from greygate.diagnose import predict

    rms = predict(rig, recording, diagnosis, out, effects)
    lines = [
        f"{name:10} RMS of simulated minus recorded {_finite(e['rms'], '.5g')} {e['unit']}" for name, e in rms.items()
    ]
    _give({"out": str(out), "rms": rms}, as_json, [*lines, f"written to {out}"])
    if not all(e["finite"] for e in rms.values()):
        _say("greygate: the simulation diverges")
        raise typer.Exit(1)


@app.command()
def augment(
    rig: Annotated[Path, typer.Argument(metavar="RIG_FOLDER", help="Folder of rig.toml and both recordings.")],
    diagnosis: Annotated[Path, typer.Option(help="Of this rig, as `greygate diagnose` wrote it.")],
    out: Annotated[Path, typer.Option(help="Folder to write; replaced if it is an earlier one.")],
    as_json: Json = False,
) -> None:
    """Train the network of a rig's plant without and with a module of the physics that a diagnosis named.

    Writes both as NAME.toml for `greygate compile`, and the recordings as they read them.
    """
    from greygate.augment import augment as join
    from greygate.mismatch.simulation import read

    with _progress("augmenting") as follow:
        facts = join(rig, read(diagnosis), out, follow)
    lines = []
    for name, figures in facts["networks"].items():
        lines.append(f"{name}: {figures['neurons']} neurons, {figures['seconds']} s. {figures['outcome']}")
        for recording, errors in figures["trained"].items():
            lines += [f"  {recording:10} {output:8} RMSE {e:.4g}" for output, e in errors.items()]
    _give(facts, as_json, [*lines, f"written to {out}"])


@app.command()
def conceal(
    plant: Annotated[str, typer.Argument(help="Its plant; an unknown name is answered by those there are.")],
    seed: Annotated[int, typer.Option(callback=options.SEED, help="Draws everything.")],
    out: Annotated[Path, typer.Option(help="Folder to write; replaced if it is an earlier case.")],
    kind: Annotated[str, typer.Option(help="clean, parameter, one, two, foreign, or any.")] = "any",
    effect: Annotated[str | None, typer.Option(help="The (first) effect, by name; drawn if not given.")] = None,
    as_json: Json = False,
) -> None:
    """Write recordings of a rig with something concealed in it, and the sealed answer."""
    from greygate.mismatch.concealed.conceal import conceal as write

    with _progress(f"recording {plant}"):
        write(plant, seed, out, kind=kind, effect=effect)
    seal = (out / "sealed.json.sha256").read_text().split()[0]
    _give({"out": str(out), "sha256": seal}, as_json, [f"written to {out}", f"answer sealed with SHA-256 {seal}"])


@app.command()
def reveal(
    folder: Annotated[Path, typer.Argument(help="A folder that `greygate conceal` wrote.")],
    diagnosis: Annotated[
        Path | None, typer.Option(help="diagnosis.json to be scored; FOLDER/diagnosis.json if it is there.")
    ] = None,
    effects: Annotated[list[Path], typer.Option(help="Tables that the diagnosis had, too.")] = [],
    as_json: Json = False,
) -> None:
    """Open the sealed answer, and score a diagnosis against it.

    Exit code 1 if the diagnosis is wrong: its verdict, its effects, or the parameter.
    """
    from greygate.diagnose import score

    found, lines, right = score(folder, diagnosis, effects)
    _give(found, as_json, lines)
    if not right:
        raise typer.Exit(1)


def run() -> None:
    """Entry point: a user's mistake is one line on stderr and exit code 2, Ctrl-C one line and 130, `kill` 143."""
    signal.signal(signal.SIGTERM, _terminated)
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # a path may hold what no text can
    try:
        code = app(standalone_mode=False) or 0
    except (KeyboardInterrupt, typer.Abort):
        code = INTERRUPTED
    except Exception as error:
        if (line := _mistake(error)) is None:
            raise
        if line:  # `greygate` alone has printed its help
            _say(f"greygate: {line}")
        code = 2
    if code == INTERRUPTED:
        _say("greygate: interrupted")
    sys.exit(code)


def _terminated(number: int, frame: object) -> None:
    """Leave by way of every `finally`, which puts temporary files away; a second such signal ends at once."""
    signal.signal(number, signal.SIG_DFL)
    sys.exit(TERMINATED)


def _mistake(error: Exception) -> str | None:
    """The line that tells the user what to do otherwise; None for what is no user's mistake."""
    if isinstance(error, InputError):
        return str(error)
    if isinstance(error, UsageError):
        return error.format_message()
    if isinstance(error, MemoryError):
        return "out of memory; give fewer or shorter recordings"
    if isinstance(error, OSError):
        return f"{error.filename or 'a file'}: {error.strerror or error}; check the path, its permissions and the disk"
    return None
