"""A structured network to start from, as `greygate init` writes it: as TOML with comments, or as a Python script."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypedDict

from greygate.errors import InputError, one_line
from greygate.files import replacing
from greygate.identify.looking import look
from greygate.models.families.blocks import feedforward
from greygate.models.families.library import LIBRARY, library
from greygate.models.layer import Layer
from greygate.models.network import Network, Port
from greygate.models.ports import ports
from greygate.names import check_name
from greygate.plain import Count
from greygate.plants.readers.read import read_recording
from greygate.plants.recording import twice
from greygate.progress import once

NEURONS = 6  # of an input's curve
SCRIPT = '''"""The network {name}, to start from: `python {name}.py` writes {name}.toml for `greygate train`."""

from greygate.models.families.blocks import feedforward
from greygate.models.families.library import library
from greygate.models.network import Layer, Network
from greygate.models.ports import ports
from greygate.plants.readers.read import read_recording
from greygate.plants.recording import twice

recording = read_recording({record!r})
inputs = ports(recording.channels, recording.units, {inputs!r})
outputs = ports(recording.channels, recording.units, {outputs!r})
rest = {{port.name: port.rest for port in outputs}}  # before the first sample
network = Network({name!r}, inputs, outputs, dt=recording.dt)
{blocks}
network.check().save({name!r})
'''


class NetworkStart(TypedDict):
    """A network to start from. delays: input -> samples. next: the command that goes on."""

    written: list[str]
    delays: dict[str, Count]
    next: str


@dataclass(frozen=True)
class Block:
    """A part of the network. says: what it is for. python: makes `module` again. feeds: (source, port, delay)."""

    name: str
    says: str
    module: Layer | Network
    python: str
    feeds: tuple[tuple[str, str, int], ...]


def blocks(inputs: Sequence[Port], outputs: Sequence[Port], late: dict[str, int], more: Sequence[str], order: int):
    """Each input is limited to what was recorded, passes `more` library networks and a curve, and moves each output.

    late: delay of each input in samples. order: how many of its own past samples an output reads. Returns the blocks.
    """
    found: list[Block] = []
    ends = {}
    for port in inputs:
        source = port.name
        keeps, limit = f"Keeps {port.name} within what was recorded.", library("limiter", lo=-1.0, hi=1.0)
        parts = [("limited", 'library("limiter", lo=-1.0, hi=1.0)', limit, keeps)]
        parts += [(k, f'library("{k}")', library(k), f"library network: {k} of {port.name}.") for k in more]
        for kind, python, module, says in parts:
            name = f"{port.name}_{kind}"
            (pin,) = module.inputs
            found.append(Block(name, says, module, python, ((source, pin.name, 0),)))
            source = f"{name}.y"
        name = f"{port.name}_curve"
        python = f'feedforward("{name}", ["x"], ({NEURONS},), seed=0)'
        module = feedforward(name, ["x"], (NEURONS,), seed=0)
        says = f"A curve of {port.name}, {NEURONS} neurons: training finds it. Put physics here that you know."
        found.append(Block(name, says, module, python, ((source, "x", 0),)))
        ends[port.name] = f"{name}.y"
    for port in outputs:
        name = f"{port.name}_motion"
        feeds = [(ends[u], f"{u}_z{d}", d) for u in ends for d in range(late[u], late[u] + order + 1)]
        feeds += [(name, f"{port.name}_z{d}", d) for d in range(1, order + 1)]
        weights = {pin: [[1.0 if pin == f"{port.name}_z1" else 0.0]] for _, pin, _ in feeds}
        says = f"Linear dynamics of order {order}, from the curves and its own past; it begins as {port.name}(k-1)."
        python = f'Layer({weights!r}, [0.0], initial=rest["{port.name}"])'
        found.append(Block(name, says, Layer(weights, [0.0], initial=port.rest), python, tuple(feeds)))
    return found


def joined(name: str, inputs: Sequence[Port], outputs: Sequence[Port], parts: Sequence[Block], dt: float) -> Network:
    """The network of the blocks, for a sample time of dt seconds."""
    network = Network(name, list(inputs), list(outputs), dt=dt)
    for block in parts:
        network.add(block.name, block.module)
    for block in parts:
        for source, pin, delay in block.feeds:
            network.connect(source, f"{block.name}.{pin}", delay)
    for port in outputs:
        network.connect(f"{port.name}_motion", port.name)
    return network.check()


def script(name: str, record: str, inputs: Sequence[Port], outputs: Sequence[Port], parts: Sequence[Block]) -> str:
    """Python that makes the same network."""
    lines = []
    for block in parts:
        lines += ["", f"# {block.says}", f'network.add("{block.name}", {block.python})']
    lines.append("")
    for block in parts:
        for source, pin, delay in block.feeds:
            lines.append(f'network.connect("{source}", "{block.name}.{pin}"{f", delay={delay}" if delay else ""})')
    lines += [f'network.connect("{p.name}_motion", "{p.name}")' for p in outputs]
    names = [[p.name for p in of] for of in (inputs, outputs)]
    return SCRIPT.format(name=name, record=record, inputs=names[0], outputs=names[1], blocks="\n".join(lines))


def init(
    path: Path,
    record: str,
    inputs: Sequence[str],
    outputs: Sequence[str],
    more: Sequence[str],
    order: int,
    python: bool,
) -> NetworkStart:
    """Write a network to start from beside nothing of its name; what was written, and the next command.

    inputs: every channel that is no output, if none is given. more: library networks of one input, ahead of the curves.
    Raises InputError for a name, a channel or a library network that cannot be, and for files that are there.
    """
    name = check_name(path.name, "--out")
    files = [path.with_name(f"{name}{end}") for end in ((".py",) if python else (".toml", ".safetensors"))]
    for file in files:
        if file.exists():
            raise InputError(f"{file}: is there already; choose another --out, or remove it")
    for kind in more:
        if kind not in LIBRARY or len(library(kind).inputs) != 1:
            known = ", ".join(k for k in LIBRARY if len(library(k).inputs) == 1)
            raise InputError(f"--block {kind}: no library network of one input; choose {known}")
    if len(set(more)) < len(more):
        raise InputError(f"--block {' '.join(more)}: one is given twice; give each once")
    recording = read_recording(record, told=once)
    inputs = inputs or [n for n in recording.channels if n not in outputs]
    if (repeated := twice((*inputs, *outputs))) is not None:
        raise InputError(f"{repeated} is given twice; a channel is one input or one output")
    if not inputs or not outputs:
        raise InputError(
            f"{record}: give an --output and leave a channel as an input; it has {', '.join(recording.channels)}"
        )
    ins, outs = (ports(recording.channels, recording.units, names) for names in (inputs, outputs))
    seen = [look(recording, inputs, output) for output in outputs]
    late = {n: min((d for s in seen if (d := s["delays"][n]) is not None), default=1) for n in inputs}
    parts = blocks(ins, outs, late, more, order)
    network = joined(name, ins, outs, parts, recording.dt)
    train = f"greygate train {path.with_suffix('.toml')} {record} --tail 0.2 --out trained"
    if python:
        with replacing(files[0]) as new:
            new.write_text(script(name, record, ins, outs, parts), encoding="utf-8", newline="\n")
    else:
        said = (
            f"A network to start from; next: {train}",
            f"The numbers are in {name}.safetensors, scales are of {record}.",
        )
        top = "\n".join(map(one_line, said))
        network.save(path, comments={"": top} | {b.name: b.says for b in parts})
    first = f"python {files[0]}" if python else train
    return {"written": [str(f) for f in files], "delays": late, "next": first}
