"""Networks on disk: structure in TOML, which a person can read, and numbers in safetensors.

The functions are methods of `models.network.Network`, whose file stands above this one.
"""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TypeVar

import numpy as np
import safetensors.numpy
import tomli_w

from greygate.errors import InputError, shown
from greygate.files import read_all, replacing_all
from greygate.models.activations import ACTIVATIONS, known
from greygate.models.layer import LARGEST_SIZE, LONGEST_DELAY, Layer, Port
from greygate.names import check_name, check_path, check_text, check_unit
from greygate.reading import Kind, anything, array, entry_of, listed, named, number, read_toml, table, whole

TRAINED = Path(__file__).resolve().parent / "trained"  # the networks of the catalogue
Kept = TypeVar("Kept")  # the class of network that is loaded


def _files(path: Path | str) -> list[Path]:
    """What is written together: structure, numbers, and the figures of a training."""
    return [Path(path).with_suffix(suffix) for suffix in (".toml", ".safetensors", ".json")]


def save(network, path: Path | str, figures: str = "", comments: Mapping[str, str] = MappingProxyType({})) -> None:
    """Write `path`.toml, which a person can read, and `path`.safetensors with the numbers; all or nothing.

    figures: text of `path`.json, if it goes with them. comments: module -> a line above it; "" for the top.
    `load` sees all of one writing, wherever it was broken off.
    """
    tensors = safetensors.numpy.save({n: np.ascontiguousarray(v) for n, v in network.parameters().items()})
    with replacing_all(_files(path)) as (text, numbers, more):
        text.write_text(_commented(tomli_w.dumps(to_toml(network)), comments), encoding="utf-8", newline="\n")
        numbers.write_bytes(tensors)
        if figures:
            more.write_text(figures, encoding="utf-8", newline="\n")


def _commented(text: str, comments: Mapping[str, str]) -> str:
    """TOML with lines of comment at its top and above modules."""
    for module, said in comments.items():
        lines = "".join(f"# {line}\n" for line in said.splitlines())
        head = f"[modules.{module}]\n"
        text = text.replace(f"\n{head}", f"\n{lines}{head}", 1) if module else lines + text
    return text


def load(kind: type[Kept], path: Path | str) -> Kept:
    """Read a saved network of class `kind`; every name and shape is checked.

    Raises InputError saying what is wrong and where.
    """
    toml, numbers, _ = files = _files(path)
    try:
        read = zip(files, read_all(files), strict=True)
        found = {file: data for file, data in read if data is not None}
        for file in (toml, numbers):
            if file not in found:
                raise InputError(f"{file}: no such file; a network is NAME.toml beside NAME.safetensors")
        data = read_toml(toml, "save the network again", found[toml])
        tensors = safetensors.numpy.load(found[numbers])
    except InputError:
        raise
    except (OSError, ValueError, KeyError, TypeError, RecursionError, safetensors.SafetensorError) as error:
        raise InputError(f"{path}: not a readable network ({error}); save it again") from None
    try:
        network = _Reader(tensors, kind).network(data, f"{toml}:", "").check()
    except InputError as error:
        said = str(error)
        raise InputError(said if said.startswith(str(path)) else f"{toml}: {said}") from None
    if tensors:
        raise InputError(f"{numbers}: holds {shown(min(tensors))}, which {toml.name} does not name")
    return network


def to_toml(network) -> dict:
    """The network as its TOML says it: all but the numbers."""
    modules = {}
    for name, module in network.modules.items():
        if not isinstance(module, Layer):
            modules[name] = to_toml(module)
            continue
        modules[name] = {
            "activation": module.activation,
            "rows": module.rows,
            "ports": {p: w.shape[1] for p, w in module.weights.items()},
            "initial": module.initial.tolist(),
            "frozen": sorted(module.frozen),
        }
    connections = []
    for c in network.connections:
        entry = {"from": c.source, "to": c.target, "delay": c.delay}
        if c.gain is not None:
            entry["gain"] = np.asarray(c.gain).tolist()
        connections.append(entry)
    ports = {
        kind: [{k: getattr(p, k) for k in p.__dataclass_fields__} for p in getattr(network, kind)]
        for kind in ("inputs", "outputs")
    }
    said = {k: v for k, v in (("dt", network.dt), ("meaning", network.meaning or None)) if v is not None}
    return {"name": network.name, **said, **ports, "modules": modules, "connections": connections}


_PORT: dict[str, Kind] = {"name": check_path}
_PORT_OPTIONS: dict[str, Kind] = {
    "unit": check_unit, "scale": number, "offset": number, "size": whole(1, LARGEST_SIZE), "initial": number,
    "resolution": number,
}  # fmt: skip
_CONNECTION: dict[str, Kind] = {"from": check_path, "to": check_path, "delay": whole(0, LONGEST_DELAY)}
_LAYER: dict[str, Kind] = {
    "activation": known,
    "rows": whole(1, 3 * LARGEST_SIZE),
    "ports": named(whole(1, LARGEST_SIZE)),
    "initial": array,
    "frozen": listed(check_path),
}


class _Reader:
    """Builds a network of class `kind` from its TOML, and takes its numbers out of `tensors`."""

    def __init__(self, tensors: dict[str, np.ndarray], kind: type):
        self.tensors, self.kind = tensors, kind

    def network(self, data: object, where: str, prefix: str):
        ports = listed(lambda entry, where: Port(**table(entry, where, _PORT, _PORT_OPTIONS)))
        connections = listed(lambda entry, where: table(entry, where, _CONNECTION, {"gain": array}))
        entries = {"name": check_name, "inputs": ports, "outputs": ports, "modules": named(anything)}
        more = {"meaning": check_text, "dt": number}
        found = table(data, where, entries | {"connections": connections}, more)
        said = {k: found[k] for k in more if k in found}
        network = self.kind(found["name"], found["inputs"], found["outputs"], **said)
        for name, entry in found["modules"].items():
            path = check_path(prefix + name, f"{where} module")
            place = entry_of(where, f"modules.{name}")
            if isinstance(entry, dict) and "modules" in entry:
                network.modules[name] = self.network(entry, place, f"{path}.")
            else:
                network.modules[name] = self.layer(entry, place, path)
        for c in found["connections"]:
            gain = c.get("gain")
            network.connect(c["from"], c["to"], c["delay"], gain if gain is None or gain.ndim else float(gain))
        return network

    def layer(self, entry: object, where: str, path: str) -> Layer:
        said = table(entry, where, _LAYER)
        if "bias" in said["ports"]:
            raise InputError(f"{where}.ports: bias is no port's name, every layer has a bias; rename the port")
        values = {}
        for port, columns in {**said["ports"], "bias": None}.items():
            shape = (said["rows"],) if port == "bias" else (said["rows"], columns)
            found = self.tensors.pop(f"{path}.{port}", np.zeros(0))
            if found.shape != shape or found.dtype.kind != "f":
                raise InputError(
                    f"layer {path}: {port} should have shape {shape}, the file holds {found.shape} of {found.dtype}"
                )
            values[port] = found
        bias, initial = values.pop("bias"), said["initial"]
        size = said["rows"] // ACTIVATIONS[said["activation"]].rows
        if initial.shape not in ((), (1,), (size,)):
            raise InputError(f"{where}.initial has shape {initial.shape}; give {size} numbers")
        return Layer(values, bias, said["activation"], initial, frozenset(said["frozen"]))
