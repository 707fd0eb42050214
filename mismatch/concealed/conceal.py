"""Recordings of a rig with something concealed in it, and the score of a diagnosis against what was concealed.

This is an independent second implementation on purpose: the head of the package says why.

A diagnosis must not depend on one formula. So half of the seeds use the standard form of an effect, and half its
variant, which the kernels name where they differ; docs/concealed.md has them side by side.
"""

import hashlib
import json
import shutil
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np

from greygate.contents import contents
from greygate.errors import InputError
from greygate.files import replaceable, replacing_folder
from greygate.plants.table import read_table
from greygate.reading import anything, line, listed, named, read_json, table

from .domains import DOMAINS
from .line import BELT, DRUM
from .printed import Sealed
from .pump import PUMP
from .rig import Columns, ConcealedRig, calibrate, errors, rms, within
from .stress import Recorder, condition
from .valve import VALVE

RIGS: dict[str, ConcealedRig] = {rig.plant: rig for rig in (VALVE, PUMP, BELT, DRUM)}
EVERY_RIG = RIGS | DOMAINS
KINDS = {"clean": 0.15, "parameter": 0.1, "one": 0.5, "two": 0.1, "foreign": 0.15}
BOTH = "both"  # a kind that is never drawn: a wrong parameter and an effect
LEAST = {"two": 0.4, "foreign": 0.3, BOTH: 0.3}  # of their range, where sizes begin: pairs and unknowns shall be seen
CLAIM = {"verdict": line, "effects": listed(anything), "where": listed(anything), "parameters": named(anything)}
OFF_TOLERANCES = 3, 6  # by how many tolerances a wrong parameter is off
FARTHEST_DOWN = 0.7  # of its value: a parameter that is off by more is larger than the data sheet's, not smaller
BARE = 0.1  # of the rigs have none of their `optional` parameters
PLANTS = Path(__file__).parent / "domains"
EVERY = 8  # of the windows is seen by the generator's own calibration
NOISE = (0.6, 1.6)  # times the usual noise of a rig's outputs
WRITTEN = "%.9g"  # a number of a small machine
DECIMALS = {"V": 5, "m": 7, "rev/s": 4, "Pa": 0}


def conceal(
    plant: str, seed: int, out: Path, *, effect: str | None = None, kind: str = "any", under: str = "white"
) -> Path:
    """Write a campaign on `plant` with something concealed to the folder `out`, and the sealed answer; return `out`.

    `rig.toml`, `identify.csv` and `holdout.csv` (and PLANT.toml of a small machine) are what a diagnosis may read;
    `third.csv` is kept back for `reveal`. `sealed.json` is the answer, `sealed.json.sha256` its seal. The same
    arguments give the same bytes.

    kind: "clean", "parameter" (one parameter 3 to 6 tolerances off), "one" or "two" effects of the vocabulary,
        "foreign" (one outside it), "any": drawn with the shares of `KINDS`; "both": a parameter and one effect.
    effect: the name of the (first) effect; drawn if None. under: the condition of `stress.CONDITIONS`.

    Raises InputError for an unknown plant, kind, effect or condition, a pair of them that excludes itself, or an `out`
    that is not a folder of this kind.
    """
    rig, stress = _rig(plant), condition(under)
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise InputError(f"conceal: seed {seed!r} is not a whole number from 0")
    replaceable(out, "conceal")
    rng = np.random.default_rng([zlib.crc32(plant.encode()), seed])
    kind = _kind(rig, kind, effect, rng)
    rig = _sensors(rig, rng)
    names = _effects(rig, kind, effect, rng)
    form = float(rng.integers(2))
    known = rig.effects | rig.foreign
    values = {name: known[name].draw(rng, LEAST.get(kind, 0.0)) for name in names}
    concealed = {key: value for drawn in values.values() for key, value in drawn.items()}
    missing = {key for name in names for key in known[name].without}
    missing |= set(rig.optional) if rng.uniform() < BARE else set()
    datasheet = {key: value for key, value in rig.parameters.items() if key not in missing}
    rig = replace(rig, tolerance={key: value for key, value in rig.tolerance.items() if key in datasheet})

    true, off = _true(rig, datasheet, kind, rng)
    recordings, recorder = {}, Recorder.of(rig, stress, rng)
    for name, seconds in rig.seconds.items():
        recordings[name] = recorder.measure(rig.record(true, concealed, form, seconds, rng), rng)
    answer = {
        "plant": plant,
        "verdict": _verdict(kind),
        "effects": names if kind in ("one", "two", BOTH) else [],
        "equation": _union(known[name].equation for name in names) if names else list(rig.places[off]) if off else [],
        "depends_on": _union(known[name].depends_on for name in names),
        "effects_true": concealed,
        "parameters_true": {name: true[name] for name in rig.tolerance},
        "kind": kind,
        "concealed": names,
        "parameter": off,
        "form": "variant" if form else "standard",
        "seed": seed,
    }
    if stress.means != condition("white").means:
        answer |= {"condition": under, "faulty": recorder.faulty}
    bare = {name: datasheet[name] if name == off else true[name] for name in datasheet}
    seen = recorder.written()
    answer |= _fits(
        replace(rig, predict=seen.predict, sample_time=seen.sample_time),
        recordings,
        datasheet,
        bare,
        true,
        concealed,
        form,
    )

    with replacing_folder(out, "conceal") as folder:
        (folder / "rig.toml").write_text(_toml(seen, datasheet), encoding="utf-8", newline="\n")
        if rig.own:
            shutil.copyfile(PLANTS / f"{plant}.toml", folder / f"{plant}.toml")
        for name, columns in recordings.items():
            _write(folder / f"{name}.csv", seen, columns)
        sealed = json.dumps(answer, indent=1) + "\n"
        (folder / "sealed.json").write_text(sealed, encoding="utf-8", newline="\n")
        (folder / "sealed.json.sha256").write_text(
            f"{hashlib.sha256(sealed.encode()).hexdigest()}  sealed.json\n", encoding="utf-8", newline="\n"
        )
    return Path(out)


def _true(
    rig: ConcealedRig, datasheet: dict[str, float], kind: str, rng: np.random.Generator
) -> tuple[dict[str, float], str | None]:
    """(the rig's true parameters, the one of them that lies outside its tolerance)."""
    true = dict(datasheet)
    for name, tolerance in rig.tolerance.items():
        true[name] *= 1 + np.clip(rng.normal(0, tolerance / 2), -tolerance, tolerance)
    if kind not in ("parameter", BOTH):
        return true, None
    off = str(rng.choice(list(rig.tolerance)))
    change = rng.uniform(*OFF_TOLERANCES) * rig.tolerance[off]
    true[off] = datasheet[off] * (1 + (change if change > FARTHEST_DOWN else change * rng.choice([-1.0, 1.0])))
    return true, off


def reveal(folder: Path, diagnosis: Path, predicted: dict[str, Path] | None = None) -> dict:
    """Score `diagnosis` (a diagnosis.json) against the sealed answer in `folder`.

    predicted: CSV files of `t` and the predicted channels over `third.csv`, by the comparison rule: "corrected", and
        "calibrated" if the share is to be of the diagnoser's own calibration error instead of the generator's.

    Returns names to values; None stands where a question does not arise:
        right_verdict, right_first (the first effect named is concealed), all_named, false_effects (names), in_set (the
        concealed effect is named or among what the first is not told apart from), right_equation, right_place (a flow
        and its continuity equation are one place), depends_on (share of the concealed variables that are named),
        right_parameter, inside (parameter to whether its ci95 holds the true value), removed (share of the removable
        error that the corrected simulation removes on the recording kept back), seconds; and of the case: plant, kind,
        concealed, form, strength, removable.

    Raises InputError for a folder without a sealed answer, a broken seal, or files that do not hold what they should.
    """
    folder = Path(folder)
    answer = sealed(folder)
    claim = read_json(diagnosis, "give a diagnosis as RIGS.md describes it")
    table(claim, f"{diagnosis}:", CLAIM, others=True)
    try:
        return _score(answer, claim) | {"removed": _removed(folder, answer, predicted or {})}
    except (KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{diagnosis}: not as RIGS.md describes a diagnosis ({error!r})") from None


def _score(answer: Sealed, claim: dict) -> dict:
    true, kind = answer["effects"], answer["kind"]
    claimed = [entry["id"] for entry in claim["effects"] if entry["id"] != "unknown"]
    alike = set(claim["effects"][0].get("not_told_apart_from", [])) if claim["effects"] else set()
    equations = {entry["equation"] for entry in claim["where"]}
    variables = {variable for entry in claim["where"] for variable in entry.get("depends_on", [])}
    first = next(iter(claim["parameters"]), None)
    return {
        "plant": answer["plant"],
        "kind": kind,
        "concealed": answer["concealed"],
        "form": answer["form"],
        "strength": answer["strength"],
        "removable": answer["removable"],
        "verdict": claim["verdict"],
        "named": claimed,
        "right_verdict": claim["verdict"] == answer["verdict"],
        "right_first": bool(claimed) and claimed[0] in true if true else None,
        "all_named": set(true) <= set(claimed) if true else None,
        "false_effects": sorted(set(claimed) - set(true)),
        "in_set": bool(set(true) & ({*claimed} | alike)) if true else None,
        "right_equation": bool(equations & set(answer["equation"])) if answer["equation"] else None,
        "right_place": bool({*map(place, equations)} & {*map(place, answer["equation"])})
        if answer["equation"]
        else None,
        "depends_on": len(variables & set(answer["depends_on"])) / len(answer["depends_on"])
        if answer["depends_on"]
        else None,
        "right_parameter": first == answer["parameter"] and bool(claim["parameters"][first].get("outside_tolerance"))
        if answer["parameter"]
        else None,
        "inside": _inside(answer, claim),
        "seconds": claim.get("seconds"),
    }


def _inside(answer: Sealed, claim: dict) -> dict[str, bool]:
    """Whether the interval of each claimed parameter holds the true value; only names that the answer has."""
    claimed = dict(claim["parameters"])
    for entry in claim["effects"]:
        if entry["id"] in answer["effects"] and answer["form"] == "standard":
            claimed |= entry.get("parameters", {})
    true = answer["parameters_true"] | (answer["effects_true"] if answer["effects"] else {})
    inside = {}
    for name in (name for name in claimed if name in true and "ci95" in claimed[name]):
        low, high = claimed[name]["ci95"]
        value = true[name]
        if name.endswith("_phase"):  # the interval may lie a whole number of turns away
            value += 2 * np.pi * round(((low + high) / 2 - value) / (2 * np.pi))
        inside[name] = within(low, value, high)
    return inside


def _removed(folder: Path, answer: Sealed, predicted: dict[str, Path]) -> float | None:
    """(E_cal - E_corrected) / (E_cal - E_true) over `third.csv`; E is the mean over channels of RMS / true RMS."""
    unknown = set(predicted) - {"corrected", "calibrated"}
    if unknown:
        raise InputError(
            f"reveal: predicted has no {sorted(unknown)[0]!r}; give 'corrected' and, if wanted, 'calibrated'"
        )
    if "corrected" not in predicted or not answer["removable"]:
        return None
    recorded = _read(folder / "third.csv")
    third, counted = answer["third"], slice(answer.get("counted_from", 0), None)

    def error(name: str) -> float:
        if name not in predicted:
            return _relative({channel: fit["calibrated"] for channel, fit in third.items()}, third)
        columns = _read(Path(predicted[name]))
        for channel in third:
            if channel not in columns or columns[channel].shape != recorded[channel].shape:
                raise InputError(f"{predicted[name]}: needs a column {channel} of {len(recorded[channel])} samples")
        return _relative({c: rms((columns[c] - recorded[c])[counted]) for c in third}, third)

    calibrated = error("calibrated")
    return (calibrated - error("corrected")) / (calibrated - 1.0) if calibrated > 1.0 else None


def _relative(fit: dict[str, float], third: dict) -> float:
    return float(np.mean([fit[channel] / third[channel]["true"] for channel in third]))


def _fits(
    rig: ConcealedRig,
    recordings: dict[str, Columns],
    datasheet: dict,
    bare: dict,
    true: dict,
    concealed: dict,
    form: float,
) -> dict:
    """Fit of datasheet, calibrated and true simulation on `third`, and what is concealed does there beside `bare`.

    The first window does not count: its speed is smoothed from one side alone, and no machine begins as that says.
    """
    third, first = recordings["third"], rig.restart
    calibrated = calibrate(rig, recordings["identify"], datasheet, every=EVERY)
    fits = {
        "simulation": errors(rig, third, datasheet, {}, 0.0),
        "calibrated": errors(rig, third, calibrated, {}, 0.0),
        "true": errors(rig, third, true, concealed, form),
    }
    without = errors(rig, third, bare, {}, 0.0)
    fit = {c.name: {key: rms(e[c.name][first:]) for key, e in fits.items()} for c in rig.predicted}
    strength = {c.name: rms((fits["true"][c.name] - without[c.name])[first:]) / c.error for c in rig.predicted}
    calibrated_error = _relative({name: values["calibrated"] for name, values in fit.items()}, fit)
    return {
        "strength": strength,
        "removable": max(0.0, 1 - 1 / calibrated_error) if concealed or bare != true else 0.0,
        "third": {c.name: {**fit[c.name], "unit": c.unit} for c in rig.predicted},
        "counted_from": first,
    }


def _rig(plant: str) -> ConcealedRig:
    if plant not in EVERY_RIG:
        raise InputError(f"conceal: no plant {plant!r}; there are {', '.join(EVERY_RIG)}")
    return EVERY_RIG[plant]


def _kind(rig: ConcealedRig, kind: str, effect: str | None, rng: np.random.Generator) -> str:
    if kind not in (*KINDS, BOTH, "any"):
        raise InputError(f"conceal: no kind {kind!r}; there are {', '.join((*KINDS, BOTH))} and any")
    drawn = str(rng.choice(list(KINDS), p=list(KINDS.values())))
    if effect is None:
        return drawn if kind == "any" else kind
    if effect not in rig.effects and effect not in rig.foreign:
        known = ", ".join([*rig.effects, *rig.foreign])
        raise InputError(f"conceal: {rig.plant} has no effect {effect!r}; there are {known}")
    fitting = ("foreign",) if effect in rig.foreign else ("one", "two", BOTH)
    if kind not in ("any", *fitting):
        raise InputError(f"conceal: {effect!r} is no case of kind {kind!r}; use {' or '.join(fitting)}")
    return fitting[0] if kind == "any" else kind


def _effects(rig: ConcealedRig, kind: str, effect: str | None, rng: np.random.Generator) -> list[str]:
    """Names of what is concealed: as many as the kind says, no two that are one claim."""
    if kind in ("clean", "parameter"):
        return []
    names = [effect or str(rng.choice(list(rig.foreign if kind == "foreign" else rig.effects)))]
    if kind == "two":
        apart = [n for n in rig.effects if n != names[0] and not any({n, names[0]} <= same for same in rig.same)]
        names.append(str(rng.choice(apart)))
    return names


def _sensors(rig: ConcealedRig, rng: np.random.Generator) -> ConcealedRig:
    """The rig with outputs of its own quality: noise between NOISE times the usual."""
    factor = float(f"{np.exp(rng.uniform(*np.log(NOISE))):.2f}")
    noisy = tuple(replace(c, noise=c.noise * factor) if c.role == "output" else c for c in rig.channels)
    return replace(rig, channels=noisy)


def _verdict(kind: str) -> str:
    known = {"clean": "consistent", "parameter": "parameter_error", "foreign": "unexplained"}
    return known.get(kind, "missing_physics")


def place(equation: str) -> str:
    """A flow and the continuity equation that it enters are one place; a sensor goes by its channel."""
    return equation.replace("flow_", "continuity_").removeprefix("sensor_")


def _union(tuples) -> list[str]:
    return list(dict.fromkeys(name for names in tuples for name in names))


def _toml(rig: ConcealedRig, datasheet: dict[str, float]) -> str:
    """`rig.toml` as the shared campaigns lay it out."""
    plant = f"{rig.plant}.toml" if rig.own else rig.plant
    lines = [f'plant = "{plant}"', f"sample_time_s = {rig.sample_time!r}"]
    lines += [f"window_s = {rig.window}"] if rig.window else []
    lines += ["predict = [" + ", ".join(f'"{c.name}"' for c in rig.predicted) + "]", ""]
    lines += ["# datasheet values, SI units", "[parameters]"]
    lines += [f"{name} = {value!r}" for name, value in datasheet.items()]
    lines += ["", "# relative uncertainty of a datasheet value (1 sigma is about half of it); the others are known"]
    lines += ["[tolerance]", *(f"{name} = {value!r}" for name, value in rig.tolerance.items())]
    for channel in rig.channels:
        lines += ["", f"[channels.{channel.name}]", f'unit = "{channel.unit}"', f'role = "{channel.role}"']
        lines += [f"resolution = {channel.resolution!r}"] if channel.resolution else []
        lines += [f"noise_rms = {channel.noise!r}"] if channel.noise else []
    return "\n".join(lines) + "\n"


def _write(path: Path, rig: ConcealedRig, columns: Columns) -> None:
    table = np.column_stack(
        [np.arange(len(columns[rig.channels[0].name])) * rig.sample_time, *(columns[c.name] for c in rig.channels)]
    )
    formats = ["%.3f", *(f"%.{DECIMALS[c.unit]}f" for c in rig.channels)] if not rig.own else WRITTEN
    np.savetxt(path, table, fmt=formats, delimiter=",", header=",".join(["t", *columns]), comments="")


def _read(path: Path) -> Columns:
    found = read_table(path, nan=True)
    return dict(zip(found.header, found.values.T, strict=True))


def sealed(folder: Path) -> Sealed:
    """The answer in `folder`, if its seal is unbroken."""
    path = folder / "sealed.json"
    try:
        seal = contents(folder / "sealed.json.sha256").decode().split()[0]
        unbroken = hashlib.sha256(contents(path)).hexdigest() == seal
    except (OSError, ValueError, IndexError):
        raise InputError(f"{folder}: holds no sealed answer; make the folder with greygate dev conceal") from None
    if not unbroken:
        raise InputError(f"{path}: is not what was sealed (SHA-256 differs); make the case again")
    return read_json(path, "make the case again")
