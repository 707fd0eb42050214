"""An FMU for co-simulation, FMI 3.0 or 2.0, of a `Model`: description, sources in C, and a library for this computer.

Source: Functional Mock-up Interface 3.0.1 and 2.0.4, https://fmi-standard.org.
"""

import hashlib
import platform
import shutil
import sys
import zipfile
from collections.abc import Iterator, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from greygate import children
from greygate.errors import InputError
from greygate.export.model import Model, Variable
from greygate.files import replacing, scratch
from greygate.plants.dimensions import base
from greygate.version import __version__

VERSIONS = ("3.0", "2.0")
COMPILERS = ("cc", "gcc", "clang")
FLAGS = ("-std=c99", "-O2", "-fPIC", "-shared", "-fvisibility=hidden", "-ffp-contract=off")
LINKED = ("-lm", "-ldl")
EPOCH = (1980, 1, 1, 0, 0, 0)  # of every file in the archive: the FMU is a function of the model
PLATFORMS = {
    "x86_64": ("x86_64", "64"),
    "AMD64": ("x86_64", "64"),
    "aarch64": ("aarch64", ""),
    "arm64": ("aarch64", ""),
}
SYSTEMS = {"linux": ("linux", ".so"), "darwin": ("darwin", ".dylib")}


def write(model: Model, path: Path | str, version: str = VERSIONS[0]) -> dict[str, Any]:
    """Write the FMU, completely or not at all, and return what it holds.

    Raises InputError for a version that is not there, and where no C compiler is found or it refuses.
    """
    if version not in VERSIONS:
        raise InputError(f"FMI {version}: give one of {', '.join(VERSIONS)}")
    number = version[0]
    own = files("greygate.export") / "fmi"
    sources = dict(model.sources)
    for name in ("instance.h", f"fmi{number}.c", *(["inner.h"] if model.resources else [])):
        sources[name] = (own / name).read_text(encoding="utf-8")
    token = _token(model, sources, version)
    sources["model.h"] = model.header(token)
    library, where = _library(model.name, sources, number)
    compiled = [name for name in sorted(sources) if name.endswith(".c")]
    held = {"modelDescription.xml": _xml(_description(model, token, compiled, number == "3"))}
    if number == "3":
        held["sources/buildDescription.xml"] = _xml(_build(model, compiled))
    held |= {f"sources/{name}": text.encode() for name, text in sorted(sources.items())}
    held[where] = library
    held |= {f"resources/{name}": content for name, content in model.resources.items()}
    with replacing(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for name, content in held.items():
            about = zipfile.ZipInfo(name, EPOCH)
            about.compress_type = zipfile.ZIP_DEFLATED
            about.external_attr = 0o644 << 16
            archive.writestr(about, content)
    variables = {what: [v.name for v in getattr(model, what)] for what in ("inputs", "parameters", "outputs")}
    return {
        "out": str(path),
        "fmi": version,
        "model": model.name,
        "step_s": model.period,
        "library": where,
        **variables,
    }


def _token(model: Model, sources: Mapping[str, str], version: str) -> str:
    """The token of a model, in the form of a GUID: other sources, units or values, another token."""
    inner = [(name, hashlib.sha256(content).hexdigest()) for name, content in sorted(model.resources.items())]
    text = repr((version, model.name, sorted(sources.items()), model.variables, model.period, *inner))
    digest = hashlib.sha256(text.encode()).hexdigest()
    return "{" + "-".join((digest[:8], digest[8:12], digest[12:16], digest[16:20], digest[20:32])) + "}"


# -- the library -----------------------------------------------------------------------------------------------------


def _library(name: str, sources: Mapping[str, str], number: str) -> tuple[bytes, str]:
    """The compiled sources, and their place in the archive."""
    compiler = next((found for c in COMPILERS if (found := shutil.which(c))), None)
    machine = PLATFORMS.get(platform.machine())
    system = next((found for s, found in SYSTEMS.items() if sys.platform.startswith(s)), None)
    if compiler is None:
        raise InputError("no C compiler (cc, gcc or clang) is found; install gcc")
    if machine is None or system is None:
        raise InputError(f"FMI has no name here for a library of {sys.platform} on {platform.machine()}")
    folder = f"{machine[0]}-{system[0]}" if number == "3" else f"{system[0]}{machine[1]}"
    with scratch() as work:
        for file, text in sources.items():
            (work / file).write_text(text, encoding="utf-8", newline="\n")
        target = f"{name}{system[1]}"
        ids = ("-Wl,--build-id=none",) if system[0] == "linux" else ()
        listed = sorted(file for file in sources if file.endswith(".c"))
        command = [compiler, *FLAGS, *ids, "-o", target, *listed, *LINKED]
        ran = children.ran(command, cwd=work)
        if ran.returncode:
            last = ran.stderr.strip().splitlines()[:1] or ["no message"]
            raise InputError(f"{compiler} does not compile the sources of {name}: {last[0]}")
        return (work / target).read_bytes(), f"binaries/{folder}/{target}"


# -- the descriptions ------------------------------------------------------------------------------------------------


def _xml(root: ET.Element) -> bytes:
    ET.indent(root)
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="utf-8") + b"\n"


def _units(root: ET.Element, model: Model) -> None:
    """Declare every unit in use; one that is known to be a multiple of SI's says so."""
    names = sorted({v.unit for v in model.variables if v.unit})
    if not names:
        return
    of = ET.SubElement(root, "UnitDefinitions")
    for name in names:
        unit = ET.SubElement(of, "Unit", name=name)
        if (known := base(name)) is not None:
            powers, factor = known
            scale = {} if factor == 1.0 else {"factor": repr(factor)}
            ET.SubElement(unit, "BaseUnit", {symbol: str(power) for symbol, power in powers.items()} | scale)


def _about(model: Model) -> dict[str, str]:
    return {
        "modelName": model.name,
        "description": model.meaning,
        "generationTool": f"greygate {__version__}",
        "variableNamingConvention": "structured",
    }


def _kinds(model: Model) -> Iterator[tuple[int, Variable, dict[str, str]]]:
    """(reference, variable, causality and variability) of each variable."""
    moves = "discrete" if model.discrete else "continuous"
    groups = (
        (model.inputs, {"causality": "input", "variability": moves}),
        (model.parameters, {"causality": "parameter", "variability": "fixed"}),
        (model.outputs, {"causality": "output", "variability": moves}),
        (model.seen, {"causality": "local", "variability": moves}),
    )
    reference = 1
    for variables, kind in groups:
        for v in variables:
            about = {"description": v.meaning} if v.meaning else {}
            yield reference, v, {"name": v.name, "valueReference": str(reference), **about, **kind}
            reference += 1


def _valued(v: Variable) -> dict[str, str]:
    """Its unit, and its value at the start."""
    return ({"unit": v.unit} if v.unit else {}) | ({} if v.start is None else {"start": repr(float(v.start))})


def _description(model: Model, token: str, compiled: list[str], newer: bool) -> ET.Element:
    """modelDescription.xml of FMI 3.0 (newer), or of 2.0."""
    version, identity, state = ("3.0", "instantiationToken", "State") if newer else ("2.0", "guid", "state")
    root = ET.Element("fmiModelDescription", {"fmiVersion": version, identity: token, **_about(model)})
    abilities = {
        "modelIdentifier": model.name,
        "canHandleVariableCommunicationStepSize": "true",
        **({"fixedInternalStepSize": repr(model.period)} if newer else {}),
        f"canGetAndSetFMU{state}": "false" if model.resources else "true",
        f"canSerializeFMU{state}": "false" if model.resources else "true",
    }
    simulated = ET.SubElement(root, "CoSimulation", abilities)
    if not newer:
        sources = ET.SubElement(simulated, "SourceFiles")
        for name in compiled:
            ET.SubElement(sources, "File", name=name)
    _units(root, model)
    ET.SubElement(root, "DefaultExperiment", startTime="0.0", stepSize=repr(model.period))
    variables = ET.SubElement(root, "ModelVariables")
    if newer:
        time = {"name": "time", "valueReference": "0", "causality": "independent", "variability": "continuous"}
        ET.SubElement(variables, "Float64", time)
    for _, v, about in _kinds(model):
        if newer:
            ET.SubElement(variables, "Float64", {**about, **_valued(v)})
        else:
            ET.SubElement(ET.SubElement(variables, "ScalarVariable", about), "Real", _valued(v))
    structure = ET.SubElement(root, "ModelStructure")
    outputs = [str(reference) for reference, _, about in _kinds(model) if about["causality"] == "output"]
    for part in ("Output", "InitialUnknown") if outputs else ():
        of = structure if newer else ET.SubElement(structure, f"{part}s")
        for reference in outputs:
            if newer:
                ET.SubElement(of, part, valueReference=reference)
            else:
                ET.SubElement(of, "Unknown", index=reference)
    return root


def _build(model: Model, compiled: list[str]) -> ET.Element:
    """How the sources are compiled, for FMI 3.0."""
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ET.SubElement(root, "BuildConfiguration", modelIdentifier=model.name)
    sources = ET.SubElement(configuration, "SourceFileSet", language="C99")
    for name in compiled:
        ET.SubElement(sources, "SourceFile", name=name)
    for name in ("m", "dl") if model.resources else ("m",):
        ET.SubElement(configuration, "Library", name=name)
    return root
