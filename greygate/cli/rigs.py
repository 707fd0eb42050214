"""Commands on rigs: diagnose, next, isolability, simulate, augment, and the concealed cases that test them."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from greygate.cli import options
from greygate.cli.backends import Backend, Scheduler, joblib_on
from greygate.cli.terminal import Json, finite, following, give, say
from greygate.errors import InputError

if TYPE_CHECKING:
    from greygate.cli.printed import Concealing, Simulating

Tables = Annotated[list[Path], typer.Option(help="TOML file with effects to try besides greygate's own.")]
RigFolder = Annotated[Path, typer.Argument(metavar="RIG_FOLDER", help="Folder that holds rig.toml.")]


def diagnose(
    rigs: Annotated[list[Path], typer.Argument(metavar="RIG_FOLDER...", help="Folders with rig.toml, identify.csv.")],
    out: Annotated[
        Path | None, typer.Option(help="diagnosis.json to write; for several rigs a folder, which gets NAME.json.")
    ] = None,
    html: Annotated[
        Path | None, typer.Option(help="HTML page to write; for several rigs a folder, which gets NAME.html.")
    ] = None,
    effects: Tables = [],
    jobs: Annotated[
        int, typer.Option(callback=options.JOBS, help="Number of rigs diagnosed at a time; dask uses all its workers.")
    ] = 1,
    backend: Annotated[
        Backend, typer.Option(help="Run on processes of this computer, or on a cluster.")
    ] = Backend.LOKY,
    scheduler: Scheduler = None,
    as_json: Json = False,
) -> None:
    """Say where a simulation and a recording differ, what physics is left out, and how much better it fits with it.

    docs/diagnosis.md describes the files. The exit code is 0 whatever the verdict. If one of several rigs cannot be
    diagnosed, the command says so, writes the others, and exits with 2.
    """
    from greygate.mismatch.explain import explain, explain_all
    from greygate.pages.diagnosis import page

    if len(rigs) == 1 and backend is Backend.LOKY and scheduler is None:
        with following("diagnosing") as progress:
            found, lines = explain(rigs[0], out, html, effects, progress, page)
        failed = []
    else:
        with joblib_on(backend, scheduler), following("diagnosing") as progress:
            results = explain_all(rigs, out, html, effects, jobs, progress, page)
        found = {name: content for name, (content, _) in results.items()}
        failed = [name for name, content in found.items() if "error" in content]
        found = found if len(rigs) > 1 else next(iter(found.values()))
        lines = [line for _, text in results.values() for line in (*text, "")][:-1]
    lines += [f"written to {path}" for path in (out, html) if path is not None]
    give("diagnosis", found, as_json, lines)
    for name in failed:
        say(f"greygate: {name}: {found[name]['error']}")
    if failed:
        raise typer.Exit(2)


def isolability(
    rig: RigFolder,
    effects: Tables = [],
    ranges: Annotated[
        list[str],
        typer.Option("--range", help="NAME=LOW:HIGH for every input: designs motions where there is no data yet."),
    ] = [],
    as_json: Json = False,
) -> None:
    """Say which effects a rig's sensors and its identify.csv cannot tell apart, and which experiment or sensor would.

    If there is no identify.csv, --range says what motions within the inputs' ranges could tell apart.
    """
    from greygate.mismatch.explain import isolable

    spans = [_range(text) for text in ranges]
    if len(dict(spans)) < len(spans):
        raise InputError(f"--range {' '.join(ranges)}: one input is given twice; give one range of each")
    with following("simulating"):
        found, lines = isolable(rig, effects, dict(spans))
    give("isolability", found, as_json, lines)


def next_(
    rig: RigFolder,
    diagnosis: Annotated[Path, typer.Option(help="diagnosis.json of this rig's identify.csv, by `greygate diagnose`.")],
    out: Annotated[Path | None, typer.Option(help="CSV to write: t and every input, to be played.")] = None,
    effects: Annotated[list[Path], typer.Option(help="Tables that the diagnosis had, too.")] = [],
    longest: Annotated[
        float, typer.Option(callback=options.SECONDS, help="Seconds that the experiment may take.")
    ] = math.inf,
    as_json: Json = False,
) -> None:
    """Find the experiment that tells apart what a diagnosis does not, within what the recording shows the rig stands.

    Exit code 1 if the diagnosis leaves nothing to tell apart, or no experiment does; it then says which sensor would.
    """
    from greygate.mismatch.proposing import propose

    with following("looking for an experiment") as progress:
        found, lines, tells = propose(rig, diagnosis, out, effects, longest, progress)
    give("next", found, as_json, [*lines, f"written to {out}"] if tells and out is not None else lines)
    if not tells:
        raise typer.Exit(1)


def _range(text: str) -> tuple[str, tuple[float, float]]:
    name, _, span = text.partition("=")
    low, _, high = span.partition(":")
    try:
        return name, (float(low), float(high))
    except ValueError:
        raise InputError(f"--range {text}: give NAME=LOW:HIGH, in the input's unit") from None


def simulate(
    rig: RigFolder,
    recording: Annotated[
        Path, typer.Option(help="CSV of this rig: its inputs, and the states that the simulation begins from.")
    ],
    out: Annotated[Path, typer.Option(help="CSV to write: t and the predicted channels.")],
    diagnosis: Annotated[
        Path | None, typer.Option(help="diagnosis.json of this plant: simulate with its corrections.")
    ] = None,
    effects: Annotated[list[Path], typer.Option(help="Tables that the diagnosis had, too.")] = [],
    own: Annotated[
        str | None,
        typer.Option("--as", help="NAME of the [recordings.NAME] whose parameters hold; by default the file's name."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Simulate a recording with the values of the data sheet, or with the plant as a diagnosis corrects it.

    Exit code 1 if the simulation diverges; the CSV file then ends in nan.
    """
    from greygate.mismatch.explain import predict

    rms = predict(rig, recording, diagnosis, out, effects, own)
    lines = [
        f"{name:10} RMS of simulated minus recorded {finite(e['rms'], '.5g')} {e['unit']}" for name, e in rms.items()
    ]
    result: Simulating = {"out": str(out), "rms": rms}
    give("simulate", result, as_json, [*lines, f"written to {out}"])
    if not all(e["finite"] for e in rms.values()):
        say("greygate: the simulation diverges")
        raise typer.Exit(1)


def augment(
    rig: RigFolder,
    diagnosis: Annotated[Path, typer.Option(help="diagnosis.json of this rig, by `greygate diagnose`.")],
    out: Annotated[Path, typer.Option(help="Folder to write; an earlier augmentation is replaced.")],
    as_json: Json = False,
) -> None:
    """Train the network of a rig's plant without and with a module of the physics that a diagnosis named.

    Writes both networks as NAME.toml for `greygate compile`, and the recordings as the networks read them.
    """
    from greygate.machines.catalog import AUGMENTED
    from greygate.mismatch.augment import augment as join
    from greygate.mismatch.simulation import read

    with following("augmenting") as progress:
        facts = join(rig, read(diagnosis), out, AUGMENTED, progress)
    lines = []
    for name, figures in facts["networks"].items():
        lines.append(f"{name}: {figures['neurons']} neurons, {figures['seconds']} s. {figures['outcome']}")
        for recording, errors in figures["trained"].items():
            lines += [f"  {recording:10} {output:8} RMSE {e:.4g}" for output, e in errors.items()]
    give("augment", facts, as_json, [*lines, f"written to {out}"])


def conceal(
    plant: Annotated[str, typer.Argument(help="Name of a plant; an unknown name lists the plants.")],
    seed: Annotated[int, typer.Option(callback=options.SEED, help="Seed from which the whole case is drawn.")],
    out: Annotated[Path, typer.Option(help="Folder to write; an earlier case is replaced.")],
    kind: Annotated[str, typer.Option(help="clean, parameter, one, two, both, foreign, or any.")] = "any",
    effect: Annotated[str | None, typer.Option(help="Name of the (first) effect; drawn if not given.")] = None,
    condition: Annotated[str, typer.Option(help="How it is recorded; an unknown name lists the ways.")] = "white",
    as_json: Json = False,
) -> None:
    """Write recordings of a rig with a concealed effect, and the sealed answer."""
    from greygate.mismatch.concealed.conceal import conceal as write

    with following(f"recording {plant}"):
        write(plant, seed, out, kind=kind, effect=effect, under=condition)
    seal = (out / "sealed.json.sha256").read_text(encoding="utf-8").split()[0]
    result: Concealing = {"out": str(out), "sha256": seal}
    give(
        "conceal",
        result,
        as_json,
        [f"written to {out}", f"answer sealed with SHA-256 {seal}"],
    )


def reveal(
    folder: Annotated[Path, typer.Argument(help="A folder that `greygate conceal` wrote.")],
    diagnosis: Annotated[
        Path | None,
        typer.Option(help="diagnosis.json to score; FOLDER/diagnosis.json if not given, where there is one."),
    ] = None,
    effects: Annotated[list[Path], typer.Option(help="Tables that the diagnosis had, too.")] = [],
    as_json: Json = False,
) -> None:
    """Open the sealed answer, and score a diagnosis against it.

    Exit code 1 if the diagnosis is wrong in its verdict, its effects, or the parameter.
    """
    from greygate.mismatch.explain import score

    found, lines, right = score(folder, diagnosis, effects)
    give("reveal", found, as_json, lines)
    if not right:
        raise typer.Exit(1)


def fit_fmu(
    fmu: Annotated[Path, typer.Argument(help="FMU for co-simulation, FMI 2.0 or 3.0.")],
    recording: Annotated[Path, typer.Argument(help="Recording with every input of the FMU, and outputs.")],
    parameter: Annotated[list[str], typer.Option(help="NAME of a parameter to fit; may be given several times.")] = [],
    trust: Annotated[bool, typer.Option("--trust", help="Run the FMU: it is a program of whoever made it.")] = False,
    as_json: Json = False,
) -> None:
    """Fit the parameters of an FMU to a recording, and say whether the recording is late, off or scaled.

    The last part of the recording is held out, and judges.
    """
    from greygate.export.calibrate import calibrate

    if not trust:
        raise InputError(f"{fmu}: an FMU is a program and runs with your rights; if you trust its maker, give --trust")
    with following("fitting") as progress:
        found = calibrate(fmu, recording, parameter, progress)
    lines = [
        f"{n:16} {p['value']:.6g} [{p['interval'][0]:.6g}, {p['interval'][1]:.6g}] {p['unit']}  (start {p['start']:g})"
        for n, p in found["parameters"].items()
    ]
    for n, e in found["rms"].items():
        parts = ", ".join(
            f"{word.replace('_', ' ')} {e[word]['held_out']:.4g}" for word in ("start", "calibrated", "with_faults")
        )
        lines.append(f"{n:16} RMS held out {e['unit']}: {parts}")
    for f in found["faults"]:
        low, high = f["interval"]
        lines.append(
            f"the recording     {f['kind']} of {f['channel']}: {f['size']:.4g} [{low:.4g}, {high:.4g}] {f['unit']}"
        )
    give("fit-fmu", found, as_json, [*lines, f"cannot show       {found['cannot_show']}"])
