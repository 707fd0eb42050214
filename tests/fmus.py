"""FMUs for the tests: a few lines of C a model, for FMI 2.0 or 3.0, model exchange or co-simulation."""

import subprocess
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from xml.etree import ElementTree as ET

PLACES = {"2.0": "linux64", "3.0": "x86_64-linux"}
SOURCE = Path(__file__).with_name("unit.c")


@dataclass(frozen=True)
class Made:
    """A model. states: name -> (start, unit). rates: name of a state -> its rate in C. outputs: name -> (unit, in C).

    code: lines of C by the place of unit.c. attributes: of the interface in the description. bounds: of parameters.
    """

    states: Mapping[str, tuple[float, str]]
    rates: Mapping[str, str]
    inputs: Mapping[str, str] = field(default_factory=dict)
    parameters: Mapping[str, tuple[float, str]] = field(default_factory=dict)
    outputs: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    code: Mapping[str, str] = field(default_factory=dict)
    indicators: int = 0
    attributes: Mapping[str, str] = field(default_factory=dict)
    bounds: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    discrete: Sequence[str] = ()

    @property
    def names(self) -> list[str]:
        """By their references."""
        return [
            *self.states, *(f"der({s})" for s in self.states), *self.inputs, *self.parameters, *self.outputs,
            *(f"z{i}" for i in range(self.indicators)),
        ]  # fmt: skip

    @property
    def starts(self) -> list[float]:
        values = {**{s: x for s, (x, _) in self.states.items()}, **{s: x for s, (x, _) in self.parameters.items()}}
        return [values.get(name, 0.0) for name in self.names]

    def header(self) -> str:
        names = self.names
        places = {name: f"(m->v[{i}])" for i, name in enumerate(names) if name.isidentifier()}
        rates = " ".join(f"m->v[{names.index(f'der({s})')}] = {text};" for s, text in self.rates.items())
        outputs = " ".join(f"m->v[{names.index(o)}] = {text};" for o, (_, text) in self.outputs.items())
        given = {
            "VALUES": len(names) + 1, "STATES": len(self.states), "INDICATORS": self.indicators,
            "STARTS": "{" + ", ".join(map(repr, self.starts)) + ", 0.0}", "RATES": f"{rates} {outputs}",
            "INDICATE": "", "EVENT": "", "NEXT": "INFINITY", "REFUSE": "", "LICENSE": "0",
            "INITIAL": "", "CRASH": "",
        }  # fmt: skip
        given |= self.code
        lines = [f"#define {name} {text}" for name, text in given.items()]
        return "\n".join([*lines, *(f"#define q_{name} {place}" for name, place in places.items()), ""])


@cache
def _library(header: str) -> bytes:
    with TemporaryDirectory() as folder:
        (Path(folder) / "model.h").write_text(header)
        command = ["gcc", "-O1", "-shared", "-fPIC", "-I", folder, str(SOURCE), "-o", f"{folder}/unit.so", "-lm"]
        subprocess.run(command, check=True)
        return (Path(folder) / "unit.so").read_bytes()


def write(path: Path, made: Made, version: str = "2.0", kind: str = "ModelExchange", place: str = "") -> Path:
    """Write an FMU; `place` is the folder of its binary."""
    text = ET.tostring(described(made, version, kind))
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", text)
        archive.writestr(f"binaries/{place or PLACES[version]}/unit.so", _library(made.header()))
        archive.writestr("resources/nothing.txt", "")
    return path


def described(made: Made, version: str, kind: str) -> ET.Element:
    newer, names = version == "3.0", made.names
    token = {"instantiationToken": "{1}"} if newer else {"guid": "{1}"}
    count = {} if newer else {"numberOfEventIndicators": str(made.indicators)}
    root = ET.Element("fmiModelDescription", {"fmiVersion": version, "modelName": "made", **token, **count})
    ET.SubElement(root, kind, {"modelIdentifier": "unit", **made.attributes})
    units = {u for _, u in [*made.states.values(), *made.parameters.values()]} | {*made.inputs.values()}
    units |= {u for u, _ in made.outputs.values()}
    if units - {""}:
        of = ET.SubElement(root, "UnitDefinitions")
        for u in sorted(units - {""}):
            ET.SubElement(of, "Unit", name=u)
    variables = ET.SubElement(root, "ModelVariables")
    if newer:
        independent = {"causality": "independent", "variability": "continuous"}
        ET.SubElement(variables, "Float64", name="time", valueReference=str(len(names)), **independent)
    groups = (
        (made.states, "local", "continuous", {s: u for s, (_, u) in made.states.items()}),
        ({f"der({s})": s for s in made.states}, "local", "continuous", {}),
        (made.inputs, "input", "continuous", made.inputs),
        (made.parameters, "parameter", "fixed", {s: u for s, (_, u) in made.parameters.items()}),
        (made.outputs, "output", "continuous", {s: u for s, (u, _) in made.outputs.items()}),
        ({f"z{i}": "" for i in range(made.indicators)} if newer else {}, "local", "continuous", {}),
    )
    for group, causality, variability, of_unit in groups:
        for name in group:
            i = names.index(name)
            moves = "discrete" if name in made.discrete else variability
            about = {"name": name, "valueReference": str(i), "causality": causality, "variability": moves}
            value = {"unit": of_unit[name]} if of_unit.get(name) else {}
            value |= made.bounds.get(name, {})
            if name in made.states:
                about["initial"] = "exact"
            if name in made.states or causality in ("input", "parameter"):
                value["start"] = repr(made.starts[i])
            if name.startswith("der("):
                value["derivative"] = str(names.index(name[4:-1]) + (0 if newer else 1))
            if newer:
                ET.SubElement(variables, "Float64", {**about, **value})
            else:
                ET.SubElement(ET.SubElement(variables, "ScalarVariable", about), "Real", value)
    structure = ET.SubElement(root, "ModelStructure")
    parts = [("Outputs", "Output", [*made.outputs])]
    if kind == "ModelExchange":
        parts.append(("Derivatives", "ContinuousStateDerivative", [f"der({s})" for s in made.states]))
        parts.append(("InitialUnknowns", "InitialUnknown", [*made.outputs, *(f"der({s})" for s in made.states)]))
    for older, part, listed in parts:
        of = structure if newer or not listed else ET.SubElement(structure, older)
        for name in listed:
            if newer:
                ET.SubElement(of, part, valueReference=str(names.index(name)))
            else:
                ET.SubElement(of, "Unknown", index=str(names.index(name) + 1))
    for i in range(made.indicators if newer else 0):
        ET.SubElement(structure, "EventIndicator", valueReference=str(names.index(f"z{i}")))
    return root


PRESS = Made(
    states={"x": (0.0, "m"), "v": (0.0, "m/s")},
    rates={"x": "q_v", "v": "(q_force - q_damping * q_v - q_stiffness * q_x) / q_mass"},
    inputs={"force": "N"},
    parameters={"mass": (2.0, "kg"), "damping": (3.0, "N.s/m"), "stiffness": (50.0, "N/m")},
    outputs={"position": ("m", "q_x"), "load": ("N", "q_stiffness * q_x")},
)
"""A mass between a spring and a damper, pushed by a force."""
