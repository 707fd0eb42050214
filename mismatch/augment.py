"""Makes a diagnosed effect a module of the plant's structured network.

    diagnosis -> module (the effect's law, as diagnosed) -> the network without it and with it -> Verilog

The module learns the law of the effect from the table of effects and is joined into the network. Both networks, without
the module and with it, start from the diagnosed parameters and are trained alike, in free run on identify.csv. Training
also rehearses the law, so that the module follows it beyond the range of the recording. Only the report uses
holdout.csv.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypedDict

import numpy as np

from greygate.errors import InputError
from greygate.files import replaceable, replacing_folder
from greygate.mismatch import effects as table
from greygate.mismatch.augmentation import Augmentation, Law, untaught
from greygate.mismatch.diagnosis import recovered
from greygate.mismatch.effects import Effect, join
from greygate.mismatch.rig import Rig, load
from greygate.mismatch.simulation import _form as form
from greygate.mismatch.simulation import check
from greygate.models.accuracy import Errors, free_run_rms
from greygate.models.network import Network
from greygate.models.training.levenberg import train
from greygate.models.training.record import Record
from greygate.plain import Count
from greygate.plants.plant import Values
from greygate.plants.recording import Recording
from greygate.progress import Progress, silent, titled

FACTS = "augment.json"
RECORDINGS = ("identify", "holdout")
EPOCHS, DECAY = 60, 1e-6
REHEARSAL = 0.1  # weight of a sample of the law, against 1 of a sample of the recording
ROUNDING = 1e-9  # error of the starting position, in its unit, by the rounding of a CSV


Kinds = Mapping[str, type[Augmentation]]
"""Plant -> its augmentation; those of the catalogue are `greygate.machines.catalog.AUGMENTED`."""


class Trial(TypedDict):
    joined: Errors
    trained: Errors
    neurons: Count
    seconds: float
    outcome: str


class Augmented(TypedDict):
    """A network of a plant without and with the physics that a diagnosis named."""

    plant: str
    effect: str
    period_s: float
    networks: dict[str, Trial]


def augment(
    folder: Path | str, diagnosis: Mapping, out: Path | str, kinds: Kinds, progress: Progress = silent
) -> Augmented:
    """Train the network of a rig's plant without and with the module of the diagnosed effect, and write both to `out`.

    diagnosis: content of a diagnosis.json of this rig. Writes PLANT.toml and PLANT_EFFECT.toml with their numbers, the
    recordings as these networks read them, and augment.json. Returns the content of augment.json: RMS errors in free
    run by network and recording, neurons, seconds. Raises InputError for an effect that has no module.
    """
    replaceable(out, "augment")
    rig = load(folder)
    effect, found = _named(rig, diagnosis, kinds)
    values = {s: p.value for s, p in rig.plant.parameters.items()}
    values |= {s: float(p["value"]) for s, p in diagnosis["parameters"].items()} | found
    kind = kinds[rig.plant.name]
    recorded = _recorded(rig, kind)
    augmentation = kind(rig, values)
    progress(f"teaching {effect.id}")
    law = _law(augmentation, rig, effect, values, recorded["identify"])
    read = {name: augmentation.recording(r) for name, r in recorded.items()}
    records = {}
    for name, r in read.items():
        inputs = {n: v for n, v in r.channels.items() if n in augmentation.inputs}
        records[name] = Record(inputs, {n: v for n, v in r.channels.items() if n not in inputs})
    networks: dict[str, Network] = {}
    figures: dict[str, Trial] = {}
    for name, module in ((rig.plant.name, None), (f"{rig.plant.name}_{effect.id}", law)):
        joined = replace(augmentation.network(recorded["identify"], module), name=name, dt=augmentation.period)
        networks[name], figures[name] = _trained(joined, augmentation, law, records, progress)
    facts: Augmented = {
        "plant": rig.plant.name,
        "effect": effect.id,
        "period_s": augmentation.period,
        "networks": figures,
    }
    with replacing_folder(out, "augment") as new:
        for name, network in networks.items():
            network.save(new / name)
        for name, r in read.items():
            r.write_csv(new / f"{name}.csv")
        (new / FACTS).write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8", newline="\n")
    return facts


def _recorded(rig: Rig, kind: type[Augmentation]) -> dict[str, Recording]:
    """Read both recordings. Raises InputError if the network cannot learn from them."""
    if missing := [name for name in kind.needs if name not in rig.channels]:
        raise InputError(f"{rig.folder / 'rig.toml'}: no channel {', '.join(missing)}; the network learns from it")
    recorded = {name: rig.recording(rig.folder / f"{name}.csv") for name in RECORDINGS}
    channel = rig.channels[kind.starts]
    for r in recorded.values():
        if abs(first := r[kind.starts][0]) > 2 * channel.sigma + ROUNDING:
            at = f"{first:g} {channel.unit}"
            raise InputError(f"{r.source}: {kind.starts} starts at {at}, but the network starts at 0; shift it to 0")
    return recorded


def _law(augmentation: Augmentation, rig: Rig, effect: Effect, values: Mapping[str, float], recorded: Recording) -> Law:
    """The law of the effect: its term with the diagnosed values."""
    place, reads = augmentation.effects[effect.id]
    plant, _ = join(rig.plant, [effect])
    (expression,) = (text for path, text in effect.terms.items() if path.startswith(f"{place}."))

    def term(**signals) -> np.ndarray:
        scope = Values(plant, signals)
        scope.update({s: v for s, v in values.items() if s in plant.parameters})
        return np.asarray(scope.evaluate(effect.lazily(expression)), float)

    return augmentation.law(recorded, reads, term)


def _trained(
    joined: Network, augmentation: Augmentation, law: Law, records: Mapping[str, Record], progress: Progress
) -> tuple[Network, Trial]:
    """The network trained in free run on identify.csv, and its figures."""
    own = [n for n in joined.modules if n in augmentation.modules]
    fit = train(
        joined,
        [records["identify"]],
        epochs=EPOCHS,
        decay=DECAY,
        rehearse={n: replace(law.record(), weight=REHEARSAL) for n in own},
        tied=(*augmentation.tied, *_alike(own)),
        progress=titled(progress, joined.name),
    )
    trained = joined.with_parameters(fit.network.parameters())
    return trained, {
        "joined": {n: free_run_rms(joined, r) for n, r in records.items()},
        "trained": {n: free_run_rms(trained, r) for n, r in records.items()},
        "neurons": joined.neurons(),
        "seconds": round(fit.seconds, 2),
        "outcome": fit.outcome.value,
    }


def _named(rig: Rig, diagnosis: Mapping, kinds: Kinds) -> tuple[Effect, dict[str, float]]:
    """The effect that becomes a module, and the values of its parameters."""
    check(diagnosis)
    plant = rig.plant.name
    if diagnosis["plant"] != plant:
        raise InputError(f"diagnosis: is of {diagnosis['plant']}, the rig is {plant}; give the rig's own")
    if plant not in kinds:
        wish = (
            "`greygate identify` builds one from a recording"
            if rig.plant.outside
            else f"these have one: {', '.join(kinds)}; `greygate build-snn --diagnosis` makes one of any other"
        )
        raise InputError(f"augment: {plant} has no structured network; {wish}")
    names = [entry["id"] for entry in diagnosis["effects"]]
    known = kinds[plant].effects
    if len(names) != 1 or names[0] not in known:
        what = " and ".join(names) or "no effect"
        raise InputError(
            f"augment: the diagnosis names {what}; a module of {plant} stands for one of {', '.join(known)}"
        )
    entry = diagnosis["effects"][0]
    effect = form(table.read(), entry)
    if effect.states:  # a module has no memory of its own, so take the plain form of the same size
        effect = table.read()[effect.id]
    return effect, recovered(effect, entry["parameters"])


def _alike(modules: Sequence[str]) -> list[list[str]]:
    """The parameters to tie, because these modules stand for one law."""
    return [[f"{module}.{name}" for module in modules] for name in untaught().parameters()] if len(modules) > 1 else []
