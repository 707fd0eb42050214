"""The next experiment on a rig, from its folder and its diagnosis: what to play as a CSV, and what it tells apart."""

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from greygate.errors import InputError, shown
from greygate.files import replacing
from greygate.mismatch.experiments.experiment import Experiment
from greygate.mismatch.experiments.proposal import Proposal, proposal
from greygate.mismatch.experiments.rivals import restored
from greygate.mismatch.explain import table_of
from greygate.mismatch.rig import SHORTEST, Rig, load
from greygate.mismatch.simulation import read
from greygate.mismatch.verdict import Verdict
from greygate.plain import plain
from greygate.progress import Progress, silent
from greygate.reading import line, listed, one_of, table

DIGITS = 9  # of a number in the file
ALIKE = {"id": line, "not_told_apart_from": listed(line)}


@np.errstate(over="ignore", invalid="ignore")  # a trial may diverge
def propose(
    folder: Path,
    diagnosis: Path,
    out: Path | None = None,
    own: Sequence[Path] = (),
    longest: float = np.inf,
    progress: Progress = silent,
) -> tuple[dict, list[str], bool]:
    """The experiment that tells the explanations of a diagnosis apart: (figures, lines to print, whether there is one).

    folder, diagnosis: of a rig and of its identify.csv. out: CSV of `t` and the inputs; it is written where there is
    an experiment. longest: s that it may take. Raises InputError, before anything is written, for a rig, a recording,
    a table or a diagnosis that cannot be used.
    """
    if out is not None and not out.absolute().parent.is_dir():
        raise InputError(f"{out.parent}: no such folder; make it, or write elsewhere")
    rig = load(folder)
    found = _checked(read(diagnosis), diagnosis, rig)
    recording = rig.to_explain()
    if longest < rig.dt * SHORTEST:
        raise InputError(f"--longest {longest:g}: below {SHORTEST} samples; give at least {SHORTEST * rig.dt:g} s")
    effects = table_of(own, rig, recording)
    entries = found["effects"]
    head = f"{rig.folder.resolve().name} ({rig.plant.name})"
    if not any(entry["not_told_apart_from"] for entry in entries):
        return {"plant": rig.plant.name, **Proposal(()).as_dict({})}, [f"{head}: {_unambiguous(found)}"], False
    try:
        made = proposal(restored(rig, recording, effects, found, progress), entries, longest, progress)
    except np.linalg.LinAlgError as error:
        raise InputError(f"{folder}: the fit fails numerically ({error}); check the values in rig.toml") from error
    units = {name: channel.unit for name, channel in rig.channels.items()}
    lines = [head, *(f"  {text}" for text in made.lines(units))]
    if made.experiment is None:
        lines.append(f"  {_untold(rig, made)}")
    elif out is not None:
        write(made.experiment, out)
    return plain({"plant": rig.plant.name, **made.as_dict(units)}), lines, made.experiment is not None


def write(experiment: Experiment, path: Path) -> None:
    """Write `t` and every input, each in its unit, whole or not at all."""
    columns = [[f"{x:.{DIGITS}g}" for x in signal.tolist()] for signal in experiment.inputs.values()]
    clock = [f"{k * experiment.dt:.12g}" for k in range(len(columns[0]))]
    with replacing(path) as temporary, temporary.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["t", *experiment.inputs])
        writer.writerows(zip(clock, *columns, strict=True))


def _checked(found: dict, path: Path, rig: Rig) -> dict:
    """A diagnosis of this rig's plant that says what it does not tell apart."""
    if found["plant"] != rig.plant.name:
        of = shown(found["plant"])[1:-1]
        raise InputError(f"{path}: is of {of}, the rig is {rig.plant.name}; give the rig's own")
    wish = "give a file that diagnose wrote"
    try:
        table(found, f"{path}:", {"verdict": one_of(Verdict)}, others=True)
        for entry in found["effects"]:
            table(entry, f"{path}: effects:", ALIKE, others=True)
    except InputError as error:
        raise InputError(f"{error}; {wish}") from None
    return found


def _unambiguous(found: dict) -> str:
    """Why there is nothing to tell apart."""
    named = " and ".join(entry["id"] for entry in found["effects"] if entry["id"] != "unknown")
    if named:
        return f"nothing to tell apart: {named} stands alone"
    return f"nothing to tell apart: the verdict is {found['verdict']}, and no effect is named"


def _untold(rig: Rig, made: Proposal) -> str:
    if not rig.inputs:
        wish = "" if any(pair.sensor for pair in made.pairs) else ": record it from another beginning, or for longer"
        return f"{rig.plant.name} has no input, so there is nothing to play{wish}"
    if any(pair.sensor for pair in made.pairs):
        return "no experiment within what was recorded tells them apart"
    return "no experiment within what was recorded tells them apart, and no sensor of a state; name what they share"
