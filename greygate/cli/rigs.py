"""Commands on rigs: diagnose, next, isolability, simulate, augment, and the concealed cases that test them."""

import math
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from greygate.cli import options, words
from greygate.cli.backends import Backend, OnBackend, Scheduler, joblib_on
from greygate.cli.terminal import Json, ended_early, finite, following, give, say
from greygate.errors import InputError
from greygate.progress import Budget

if TYPE_CHECKING:
    from greygate.cli.printed import Concealing, Simulating

Diagnosis = Annotated[Path, words.DIAGNOSIS]
MaybeDiagnosis = Annotated[Path | None, words.DIAGNOSIS]


def diagnose(
    rigs: Annotated[list[Path], typer.Argument(metavar="RIG", help="Folders with rig.toml, identify.csv.")],
    out: Annotated[
        Path | None, typer.Option(metavar="FILE.json", help="diagnosis.json; for several rigs a folder for NAME.json.")
    ] = None,
    html: Annotated[
        Path | None, typer.Option(metavar="FILE.html", help="HTML page; for several rigs a folder for NAME.html.")
    ] = None,
    effects: words.Effects = [],
    accept: Annotated[
        bool, typer.Option("--accept", help="Put the formula for what has no name into RIG/effects.toml.")
    ] = False,
    seconds: Annotated[float, words.SECONDS] = 120.0,
    jobs: words.Jobs = 1,
    backend: OnBackend = Backend.LOKY,
    scheduler: Scheduler = None,
    trust: words.Trust = False,
    as_json: Json = False,
) -> None:
    """Name the physics that a simulation leaves out.

    It says where simulation and recording differ, and how much better the simulation fits with what it names.
    After --seconds, or Ctrl-C, no further hypothesis is fitted: what was found so far is said.
    docs/diagnosis.md describes the files. The exit code is 0 whatever the verdict. If one of several rigs cannot be
    diagnosed, the command says so, writes the others, and exits with 2.
    """
    from greygate.mismatch.accepted import accept as accepted
    from greygate.mismatch.explain import explain, explain_all
    from greygate.pages.diagnosis import page

    _trusting(rigs if trust else ())
    if accept and len(rigs) > 1:
        raise InputError("--accept takes the formula of one rig; give one")
    if len(rigs) == 1 and backend is Backend.LOKY and scheduler is None:
        with following("diagnosing") as progress, ended_early(Budget(seconds)) as budget:
            found, lines = explain(rigs[0], out, html, effects, progress, page, budget)
        failed = []
    else:
        with joblib_on(backend, scheduler), following("diagnosing") as progress:
            results = explain_all(rigs, out, html, effects, jobs, progress, page, seconds)
        found = {name: content for name, (content, _) in results.items()}
        failed = [name for name, content in found.items() if "error" in content]
        found = found if len(rigs) > 1 else next(iter(found.values()))
        lines = [line for _, text in results.values() for line in (*text, "")][:-1]
    lines += [f"written to {path}" for path in (out, html) if path is not None]
    give("diagnosis", found, as_json, lines)
    if accept:
        say(accepted(rigs[0], found))
    for name in failed:
        say(f"greygate: {name}: {found[name]['error']}")
    if failed:
        raise typer.Exit(2)


def _trusting(rigs: Iterable[Path]) -> None:
    from greygate.mismatch.rig import trusting

    for rig in rigs:
        trusting(rig)


def isolability(
    rig: words.Rig,
    effects: words.Effects = [],
    ranges: Annotated[
        list[str],
        typer.Option("--range", metavar="NAME=LOW:HIGH", help="Of every input: designs motions without data."),
    ] = [],
    as_json: Json = False,
) -> None:
    """Say which effects a rig's sensors and data cannot tell apart.

    It names the experiment or the sensor that would.
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
    rig: words.Rig,
    diagnosis: Diagnosis,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE.csv", help="CSV to write: t and every input, to be played.")
    ] = None,
    effects: words.Effects = [],
    longest: Annotated[
        float, typer.Option(callback=options.SECONDS, help="Seconds that the experiment may take.")
    ] = math.inf,
    as_json: Json = False,
) -> None:
    """Find the experiment that resolves a diagnosis.

    It tells apart what the diagnosis does not. It stays within what the recording shows the rig stands, and has the
    effects that the diagnosis had. Exit code 1 if the diagnosis leaves nothing to tell apart, or no experiment does; it
    then says which sensor would.
    """
    from greygate.mismatch.proposing import propose

    with following("looking for an experiment") as progress:
        found, lines, tells = propose(rig, diagnosis, out, effects, longest, progress)
    give("next", found, as_json, [*lines, f"written to {out}"] if tells and out is not None else lines, tells)


def _range(text: str) -> tuple[str, tuple[float, float]]:
    name, _, span = text.partition("=")
    low, _, high = span.partition(":")
    try:
        return name, (float(low), float(high))
    except ValueError:
        raise InputError(f"--range {text}: give NAME=LOW:HIGH, in the input's unit") from None


def simulate(
    rig: words.Rig,
    recording: words.Recording,
    out: Annotated[Path, typer.Option(metavar="FILE.csv", help="CSV to write: t and the predicted channels.")],
    diagnosis: MaybeDiagnosis = None,
    effects: words.Effects = [],
    own: Annotated[
        str | None,
        typer.Option("--as", metavar="NAME", help="Of the [recordings.NAME] that holds; else the file's name."),
    ] = None,
    trust: words.Trust = False,
    as_json: Json = False,
) -> None:
    """Simulate a recording, as the data sheet says or a diagnosis.

    The recording has the rig's inputs, and the states that the simulation begins from. Exit code 1 if the simulation
    diverges; the CSV file then ends in nan.
    """
    from greygate.mismatch.explain import predict

    _trusting([rig] if trust else ())
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
    rig: words.Rig,
    diagnosis: Diagnosis,
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder to write; an earlier augmentation is replaced.")],
    as_json: Json = False,
) -> None:
    """Train a rig's network without and with the physics named.

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
    plant: Annotated[str, typer.Argument(metavar="PLANT", help="Name of a plant; an unknown name lists the plants.")],
    seed: Annotated[int, words.SEED],
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder to write; an earlier case is replaced.")],
    kind: Annotated[str, typer.Option(help="clean, parameter, one, two, both, foreign, or any.")] = "any",
    effect: Annotated[str | None, typer.Option(help="Name of the (first) effect; drawn if not given.")] = None,
    condition: Annotated[str, words.CONDITION] = "white",
    as_json: Json = False,
) -> None:
    """Write a rig with a concealed effect and a sealed answer."""
    from greygate.mismatch.concealed.conceal import conceal as write

    with following(f"recording {plant}"):
        write(plant, seed, out, kind=kind, effect=effect, under=condition)
    seal = (out / "sealed.json.sha256").read_text(encoding="utf-8").split()[0]
    result: Concealing = {"out": str(out), "sha256": seal}
    give("conceal", result, as_json, [f"written to {out}", f"answer sealed with SHA-256 {seal}"])


def reveal(
    folder: Annotated[Path, typer.Argument(metavar="RIG", help="A folder that `greygate dev conceal` wrote.")],
    diagnosis: MaybeDiagnosis = None,
    effects: words.Effects = [],
    as_json: Json = False,
) -> None:
    """Open the sealed answer, and score a diagnosis against it.

    That is RIG/diagnosis.json, where there is one, if none is given. Exit code 1 if the diagnosis is wrong in its
    verdict, its effects, or the parameter.
    """
    from greygate.mismatch.explain import score

    found, lines, right = score(folder, diagnosis, effects)
    give("reveal", found, as_json, lines, right)
