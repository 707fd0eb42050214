"""No file from a stranger ends in anything but success or one line that says what is wrong."""

import ast
import importlib
import json
import os
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from fuzzing import Sandbox, campaign
from programs import random_codes, random_program

from greygate.emulator import engine
from greygate.emulator.interpreter import interpret
from greygate.emulator.program import Program
from greygate.hardware.build import Project
from greygate.machines.source import Source
from greygate.mismatch import effects, rig, simulation
from greygate.mismatch.concealed import conceal
from greygate.models.families.regression import noe
from greygate.models.network import Network
from greygate.models.ports import ports
from greygate.plants.recording import read_csv
from greygate.project import compile_project

pytestmark = pytest.mark.nightly

ROOT = Path(__file__).parent.parent
RIGS = sorted(path.parent for path in (ROOT / "recordings" / "rigs").glob("*/rig.toml"))
IN_TESTS = 100  # mutants a parser; `make fuzz` takes 10,000
SEEDS = 40  # of a parser, about as many of which are opened as they are; `make fuzz` opens all
MUTANTS = int(os.environ.get("GREYGATE_FUZZ", IN_TESTS))
RESULTS = ROOT / "benchmarks" / "results" / "fuzz.json"
SIMULATE = importlib.import_module("greygate.plants.simulator")  # the package has a function of this name
PROJECT = importlib.import_module("greygate.hardware.build")
ARITHMETIC = (ast.Module, ast.Expr, ast.Name, ast.Constant, ast.Call, ast.UnaryOp, ast.BinOp, ast.expr_context,
              ast.UAdd, ast.USub, ast.Add, ast.Sub, ast.Mult, ast.Div, ast.Pow)  # fmt: skip
SHARE = 0.05  # of the mutants that shall be accepted, and refused: else the fuzz reaches nothing, or mends nothing


# ---- what the product does first with each file: functions of the folder in which it lies


class Held:
    """In place of a compiled plant, which takes numba seconds: states stay where they begin."""

    def __init__(self, plant, text: str):
        compile(text, "plant", "exec")

    def restarted(self, starts, *others):
        others[-1][:] = starts[0]
        return -1


def _simulated(folder: Path, changed=None, diagnosis=None, own=None) -> None:
    """`greygate simulate` of the folder's rig.

    changed: makes another plant of the rig's. own: effects in place of those known.
    """
    SIMULATE._Loop = Held
    found = rig.load(folder)
    recording = found.recording(folder / "identify.csv")
    if changed is not None:
        found = replace(found, plant=changed(found.plant))
    simulation.simulate(found, recording, diagnosis, own)
    signals = {name: np.zeros(3) for name in found.plant.inputs}
    SIMULATE.simulate(found.plant, signals, sample_time=found.dt, step=found.dt)


def open_rig(folder: Path) -> None:
    _simulated(folder)


def open_diagnosis(folder: Path) -> None:
    _simulated(folder, diagnosis=simulation.read(folder / "diagnosis.json"))


def open_expression(folder: Path) -> None:
    """The expression in the place that place.json tells."""
    place = json.loads((folder / "place.json").read_text())
    text = (folder / "expression").read_bytes().decode("utf-8", "surrogateescape")

    def changed(plant):
        match place["kind"]:
            case "term":
                return plant.with_term(place["where"], place["term"], text)
            case "storage":
                equation = replace(plant.equations[place["where"]], storage=text)
                return replace(plant, equations={**plant.equations, place["where"]: equation})
            case "state":
                state = replace(plant.states[place["where"]], **{place["entry"]: text})
                return replace(plant, states={**plant.states, place["where"]: state})
        return plant

    diagnosis = None
    if place["kind"] == "unknown":
        parameters = {"unknown_1": {"value": 1.0, "place": place["where"], "term": text}}
        effect = {"id": "unknown", "equations": ["motion"], "parameters": parameters}
        head = {"schema": "diagnosis/1", "plant": place["plant"], "verdict": "missing_physics"}
        diagnosis = {**head, "effects": [effect], "parameters": {}}
    _simulated(folder, changed, diagnosis, {})
    strange = [type(node).__name__ for node in ast.walk(ast.parse(f"({text}\n)")) if not isinstance(node, ARITHMETIC)]
    assert not strange, f"accepted although it is no arithmetic: {strange}"


def open_network(folder: Path) -> None:
    network = Network.load(folder / "network")
    network.run({p.name: np.full((4, p.size) if p.size > 1 else 4, p.offset) for p in network.inputs})


def open_program(folder: Path) -> None:
    program = Program.load(folder / "program.json")
    codes = random_codes(program, 0, 5)
    ours, fast = interpret(program, codes), engine.run(program, codes)
    assert np.array_equal(ours.outputs, fast.outputs), "the engine answers otherwise than the interpreter"
    program.decode(ours.outputs)
    program.encode({p.name: np.zeros((3, p.signal.size) if p.signal.size > 1 else 3) for p in program.inputs})


def open_csv(folder: Path) -> None:
    read_csv(folder / "recording.csv")


def open_rig_csv(folder: Path) -> None:
    rig.load(folder).recording(folder / "identify.csv")


def open_project(folder: Path) -> None:
    os.chdir(folder)
    PROJECT.changed = lambda *_: []  # a stranger makes the manifest agree
    project = Project.open(folder)
    project.compiled(project.source.records())
    project.scenarios()
    _ = [project.case(architecture) for architecture in project.facts["architectures"]]
    _ = project.hardware, project.resources, project.source.title, project.source.references


# ---- valid files to start from


def _recording(found: rig.Rig) -> bytes:
    """A recording of a rig at its initial state, with a swing."""
    plant = found.plant
    samples = max(rig.SHORTEST, found.window or 0, 60) + 1
    rows = ["t," + ",".join(found.channels)]
    rest = [plant.constant(plant.states[name].initial) if name in plant.states else 0.0 for name in found.channels]
    for k in range(samples):
        swing = 1e-3 * np.sin(0.1 * k)
        rows.append(",".join([f"{k * found.dt:.6g}", *(f"{x + swing:.6g}" for x in rest)]))
    return ("\n".join(rows) + "\n").encode()


@cache
def _rigs(folder: Path) -> dict[str, dict[str, bytes]]:
    """Rig -> its files: the measured ones in the repo, and one of each plant that conceals effects."""
    found = {}
    for path in (path for path in RIGS if not [*path.glob("*.xml")]):  # a plant in TOML
        found[path.name] = {p.name: p.read_bytes() for p in path.glob("*.toml")}
    for name, maker in conceal.RIGS.items():
        plant = next(rig.PLANTS.glob(f"*/{name}.toml")).read_bytes()
        for rig_name, left_out in ((name, ()), (f"{name} without", maker.optional)):
            sheet, tolerance = ({k: v for k, v in table.items() if k not in left_out}
                                for table in (maker.parameters, maker.tolerance))  # fmt: skip
            text = conceal._toml(replace(maker, tolerance=tolerance), sheet)
            text = text.replace(f'plant = "{name}"', f'plant = "{name}.toml"')
            found[rig_name] = {"rig.toml": text.encode(), f"{name}.toml": plant}
    for name, files in found.items():
        where = folder / name
        where.mkdir()
        for file, data in files.items():
            (where / file).write_bytes(data)
        files["identify.csv"] = _recording(rig.load(where))
    return found


def _plant(files: dict[str, bytes]) -> tuple[str, dict]:
    """The rig's plant: its name, and the content of its file."""
    name = tomllib.loads(files["rig.toml"].decode())["plant"]
    return name.removesuffix(".toml"), tomllib.loads(files[name].decode())


def rig_seeds(folder: Path) -> list[dict[str, bytes]]:
    return list(_rigs(folder).values())


def plant_seeds(folder: Path) -> list[dict[str, bytes]]:
    return [{**files, "effects.toml": b""} for files in _rigs(folder).values()]


def effect_seeds(folder: Path) -> list[dict[str, bytes]]:
    """The rigs' own tables, and the entries of those that come along, three at a time."""
    seeds = [files for files in _rigs(folder).values() if "effects.toml" in files]
    for table in (effects.TABLE, *effects.EXTRA.values()):
        entries = tomllib.loads(table.read_text())
        for name in conceal.RIGS:
            own = [(key, e) for key, e in entries.items() if name in e.get("plants", ())]
            for first in range(0, len(own), 3):
                text = tomli_w.dumps(dict(own[first : first + 3]))
                seeds.append({**_rigs(folder)[name], "effects.toml": text.encode()})
    return seeds


def diagnosis_seeds(folder: Path) -> list[dict[str, bytes]]:
    """Stored diagnoses, each with its rig."""
    seeds = []
    for path in sorted((ROOT / "benchmarks" / "results").glob("*/*.json")):
        found = json.loads(path.read_text())
        if str(found.get("schema")).startswith("diagnosis/"):
            name = path.stem if path.stem in _rigs(folder) else found["plant"]
            claimed = {symbol for effect in found["effects"] for symbol in effect["parameters"]}
            if name in conceal.RIGS and claimed & set(conceal.RIGS[name].optional):
                name = f"{name} without"
            if name in _rigs(folder):  # a MuJoCo model is none of them
                seeds.append({**_rigs(folder)[name], "diagnosis.json": path.read_bytes()})
    return seeds


def expression_seeds(folder: Path) -> list[dict[str, bytes]]:
    """Every expression of every plant, and in the place of an unknown term those of its equations."""
    seeds = []
    for files in _rigs(folder).values():
        (name, table), found = _plant(files), {**files, "effects.toml": b""}

        def add(text, found=found, name=name, **place):
            place = json.dumps({"plant": name, **place}).encode()
            seeds.append({**found, "place.json": place, "expression": str(text).encode()})

        for where, lines in {**table.get("definitions", {}), **table.get("equations", {})}.items():
            for term, text in next(iter(lines.values())).items():
                if term not in ("unit", "storage", "couples"):
                    add(text, kind="term", where=where, term=term)
                    add(text, kind="unknown", where=where)
            if "storage" in next(iter(lines.values())):
                add(next(iter(lines.values()))["storage"], kind="storage", where=where)
        for where, state in table.get("states", {}).items():
            for entry in {"initial", "low", "high", "start"} & set(state):
                add(state[entry], kind="state", where=where, entry=entry)
        for channel in tomllib.loads(files["rig.toml"].decode())["predict"]:
            if channel in table.get("states", {}):
                add(f"0.01 * {channel} * abs({channel})", kind="unknown", where=f"sensor_{channel}")
    return seeds


def network_seeds(folder: Path) -> list[dict[str, bytes]]:
    stored = sorted(ROOT.glob("models/trained/*.toml")) + sorted(ROOT.glob("models/trained/library/*.toml"))
    return [
        {"network.toml": p.read_bytes(), "network.safetensors": p.with_suffix(".safetensors").read_bytes()}
        for p in stored
    ]


def program_seeds(folder: Path) -> list[dict[str, bytes]]:
    seeds = []
    for seed in range(40):
        random_program(seed).save(folder / "program.json")
        seeds.append({"program.json": (folder / "program.json").read_bytes()})
    return seeds


def csv_seeds(folder: Path) -> list[dict[str, bytes]]:
    """Recordings in the repo, cut short."""
    stored = [p for p in sorted((ROOT / "recordings").glob("*/*.csv")) if p.read_text().startswith("t_s,")]
    return [{"recording.csv": b"".join(p.read_bytes().splitlines(True)[:12])} for p in stored]


def project_seeds(folder: Path) -> list[dict[str, bytes]]:
    """A compiled network with its recording, as if it had been verified and synthesized."""
    record = folder / "train.csv"
    lines = (ROOT / "recordings" / "servohydraulic-mts" / "mts_15Hz0A.csv").read_text().splitlines(True)
    record.write_text("".join(lines[:60]))
    read = read_csv(record)
    x_cmd, x_meas = ports(read.channels, read.units, ["x_cmd", "x_meas"])
    noe("mine", {x_cmd: (1, 2)}, x_meas, (1, 2), hidden=(2,)).save(folder / "mine")
    source = Source(str(folder / "mine.toml"), {"training": str(record)})
    compile_project(source, folder / "build", source.formats())
    files = {str(p.relative_to(folder / "build")): p.read_bytes() for p in (folder / "build").rglob("*") if p.is_file()}
    facts = json.loads(files["compile.json"]) | {"source": "mine.toml", "recordings": {"training": "train.csv"}}
    files |= {p.name: p.read_bytes() for p in folder.glob("mine.*")}
    verified = {a: {"clocks_per_step": 1.0, "seed": 0, "scenarios": {"training": {"steps": 59, "differing_bits": 0,
                "mismatch": ""}}} for a in ("parallel", "folded")}  # fmt: skip
    counted = {f"{a}, ecp5": {"luts": 10, "flip_flops": 20} for a in ("parallel", "folded")}
    more = {"compile.json": facts, "verify.json": verified, "resources.json": counted}
    texts = {name: (json.dumps(value, indent=1) + "\n").encode() for name, value in more.items()}
    return [{**files, **texts, "train.csv": record.read_bytes()}]


@dataclass(frozen=True)
class Parser:
    """entrance: folder -> None. seeds: folder to work in -> folders of files. targets: files that are changed."""

    entrance: Callable[[Path], None]
    seeds: Callable[[Path], list[dict[str, bytes]]]
    targets: tuple[str, ...]


PARSERS = {
    "expressions": Parser(open_expression, expression_seeds, ("expression",)),
    "rig.toml": Parser(open_rig, rig_seeds, ("rig.toml",)),
    "plant.toml": Parser(open_rig, plant_seeds, ("plant.toml", *(f"{name}.toml" for name in conceal.RIGS))),
    "effects.toml": Parser(open_rig, effect_seeds, ("effects.toml",)),
    "diagnosis.json": Parser(open_diagnosis, diagnosis_seeds, ("diagnosis.json",)),
    "network.toml": Parser(open_network, network_seeds, ("network.toml", "network.toml", "network.safetensors")),
    "program.json": Parser(open_program, program_seeds, ("program.json",)),
    "CSV": Parser(open_csv, csv_seeds, ("recording.csv",)),
    "CSV of a rig": Parser(open_rig_csv, rig_seeds, ("identify.csv",)),
    "compile.json": Parser(open_project, project_seeds, ("compile.json", "verify.json", "resources.json")),
}


@pytest.fixture(scope="module")
def sandbox():
    box = Sandbox()
    yield box
    box.close()


@pytest.fixture(scope="module")
def workshop(tmp_path_factory):
    return tmp_path_factory.mktemp("seeds")


@pytest.mark.parametrize("name", PARSERS)
def test_a_mutant_of_a_valid_file_is_read_or_refused_in_a_line(name, sandbox, workshop):
    parser = PARSERS[name]
    seeds = parser.seeds(workshop)
    for seed in seeds if MUTANTS > IN_TESTS else seeds[:: max(len(seeds) // SEEDS, 1)]:
        ending = sandbox.open(parser.entrance, seed, guarded=False)
        assert ending.kind == "accepted", (ending, [v for k, v in seed.items() if k in parser.targets])
    tally = campaign(sandbox, parser.entrance, seeds, parser.targets, MUTANTS)
    print(name, tally.as_dict())
    if MUTANTS > IN_TESTS:
        results = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
        RESULTS.write_text(json.dumps(results | {name: tally.as_dict()}, indent=1) + "\n")
    shown = [
        f"{times} x {kind}: {message[:300]}\n{made.story} {made.changed}: {made.files[made.changed][:400]!r}"
        for kind, (made, message, times) in tally.failures.items()
    ]
    if shown:
        pytest.fail("\n\n".join(shown), pytrace=False)
    assert min(tally.accepted, tally.refused) >= SHARE * MUTANTS
