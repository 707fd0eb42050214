"""From a network of MATLAB's Deep Learning Toolbox, saved as a struct in a .mat file (v5 or v7.3; docs/importers.md).

IW{i,j}, LW{i,j}, b{i}               weights of layer i on input j, on layer j; its bias
inputDelays{i,j}, layerDelays{i,j}   delays of those weights in steps; 0 where they are missing
transferFcn{i}                       tansig, logsig, purelin, poslin, satlin, satlins, hardlim, hardlims, radbas
inputProcess{j}, outputProcess{i}    settings of mapminmax and mapstd, in the order in which they act
inputs, outputs                      names, such as 'u [V]', one for each element
Xi, Ai                               states before the first step, as preparets gives them; 0 where they are missing

Or the plain layers of verification contests: W{i}, b{i}, act_fcns{i}, the layer's weights on the one before.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from greygate.errors import InputError, shown
from greygate.foreign import read_mat
from greygate.models.importers.builder import Builder, Value, constant, port, titled
from greygate.models.network import Network, Port

TRANSFER = {
    "tansig": "tansig", "logsig": "logsig", "hardlim": "hardlim", "hardlims": "hardlims", "satlin": "satlin",
    "radbas": "radbas",
}  # fmt: skip
"""Transfer function -> activation, where they are the same."""
PLAIN = {"relu": "poslin", "linear": "purelin", "tanh": "tansig", "sigmoid": "logsig"}
"""Names in act_fcns -> transfer function; the others are the same."""


def from_matlab(
    path: Path | str,
    inputs: Sequence[Port | str] | None = None,
    outputs: Sequence[Port | str] | None = None,
    name: str | None = None,
) -> Network:
    """The network of a .mat file; a closed-loop NARX network and its delays included.

    inputs, outputs: ports, or names, one for each element; by default those of the file. Before the first step inputs
    are 0, in their units, and so are layers, but where the file has Xi and Ai.
    Raises InputError for a file that is none, and for a function or a setting that is not carried.

    >>> from scipy.io import savemat
    >>> cell = lambda value: np.array([[value, None]], object)[:, :1]
    >>> fields = {"IW": cell([[0.5]]), "b": cell([[1.0]]), "transferFcn": cell("tansig")}
    >>> savemat("net.mat", fields | {"inputs": cell("u [V]"), "outputs": cell("y [m]")})
    >>> from_matlab("net.mat")
    <Network net: u [V] -> y [m]; 2 layers, 4 parameters>
    """
    path = Path(path)
    found = _read(path)
    return _Layout(path, found, inputs, outputs).network(name or titled(path))


class _Layout:
    """The fields of a file, each checked when it is read."""

    def __init__(self, path: Path, found: Mapping[str, Any], inputs: Any, outputs: Any):
        self.path, self.found = path, _layered(found)
        found = self.found
        if missing := [f for f in ("IW", "b", "transferFcn") if f not in found]:
            raise InputError(
                f"{path}: has no {missing[0]}, but {', '.join(sorted(found)) or 'nothing'}; write a network with the "
                "function on docs/importers.md, and plain layers with W = {W1, W2}; b = {b1, b2}; "
                "act_fcns = {'tansig', 'purelin'}; save('net.mat', 'W', 'b', 'act_fcns')"
            )
        self.transfer = [str(v) for v in _cells(found["transferFcn"]).ravel()]
        self.layers = len(self.transfer)
        self.iw, self.lw = self._grid("IW"), self._grid("LW", self.layers)
        self.ports = [self._ports("inputs", inputs), self._ports("outputs", outputs)]

    def _grid(self, field: str, columns: int | None = None) -> np.ndarray:
        """A cell array (layers, ...), whatever MATLAB made of one row or one column."""
        given = _cells(self.found.get(field, np.empty((self.layers, 0), object)))
        if given.size == 0:
            return np.empty((self.layers, columns or 1), object)
        if given.ndim == 1 or given.shape[0] != self.layers:
            given = given.reshape(self.layers, -1)
        return given

    def _ports(self, field: str, given: Any) -> list[Port]:
        if given is not None:
            return [port(g) for g in given]
        names = [str(v) for v in _cells(self.found.get(field, np.empty(0, object))).ravel()]
        if not names and "act_fcns" in self.found:
            count = sum(self._sizes()) if field == "inputs" else sum(self._size(k) for k in self._outputs())
            names = [f"{'x' if field == 'inputs' else 'y'}_{k + 1}" for k in range(count)]
        if not names:
            raise InputError(f"{self.path}: names no {field}; write {field} = {{'u [V]', ...}}, one for each element")
        return [port(n) for n in names]

    def _delays(self, field: str, i: int, j: int) -> list[int]:
        grid = self._grid(field)
        value = grid[i, j] if j < grid.shape[1] else None
        if value is None or np.size(value) == 0:
            return [0]
        found = np.asarray(value, float).ravel()
        if (found != np.round(found)).any() or (found < 0).any():
            raise InputError(f"{self.path}: {field}{{{i + 1},{j + 1}}} is {found}; delays are whole numbers of steps")
        return [int(d) for d in found]

    def network(self, name: str) -> Network:
        builder = Builder(name, *self.ports)
        sizes = self._sizes()
        if sum(sizes) != len(builder.inputs):
            raise InputError(f"{self.path}: {sum(sizes)} input elements and {len(self.ports[0])} names; name each")
        entered, start = [], 0
        for j, size in enumerate(sizes):
            value = builder.input(builder.inputs[start : start + size], (size,))
            for offset, gain, low in self._steps("inputProcess", j):
                value = value.plus(constant(-offset)).times(gain).plus(constant(low))
            entered.append(value)
            start += size
        self.delayed: dict[tuple[str, int], list[Value]] = {}
        for k in range(self.layers):
            self._layer(builder, k, entered)
        start = 0
        for k in self._outputs():
            value = _of_layer(f"layer{k + 1}", self._size(k))
            for offset, gain, low in reversed(self._steps("outputProcess", k)):
                value = value.plus(constant(-low)).times(1.0 / gain).plus(constant(offset))
            builder.output(builder.outputs[start : start + value.size], value)
            start += value.size
        if start != len(builder.outputs):
            raise InputError(f"{self.path}: {start} output elements and {len(self.ports[1])} names; name each")
        return builder.finished()

    def _sizes(self) -> list[int]:
        """Elements of each input."""
        found = []
        for j in range(self.iw.shape[1]):
            i = next((i for i in range(self.layers) if _filled(self.iw[i, j])), None)
            if i is None:
                raise InputError(f"{self.path}: input {j + 1} reaches no layer")
            columns = np.atleast_2d(np.asarray(self.iw[i, j], float)).shape[1]
            found.append(columns // len(self._delays("inputDelays", i, j)))
        return found

    def _size(self, k: int) -> int:
        return int(np.size(_cells(self.found["b"]).ravel()[k])) or self._rows(k)

    def _rows(self, k: int) -> int:
        of = [w for w in (*self.iw[k], *self.lw[k]) if _filled(w)]
        if not of:
            raise InputError(f"{self.path}: layer {k + 1} reads nothing")
        return np.atleast_2d(np.asarray(of[0], float)).shape[0]

    def _outputs(self) -> list[int]:
        """The layers that are outputs: those of `outputConnect`, else the last."""
        given = self.found.get("outputConnect")
        chosen = [k for k, on in enumerate(np.ravel(np.asarray(given, float))) if on] if given is not None else []
        return chosen or [self.layers - 1]

    def _layer(self, builder: Builder, k: int, entered: Sequence[Value]) -> None:
        size = self._size(k)
        bias = np.ravel(np.asarray(_cells(self.found["b"]).ravel()[k], float))
        total = constant(bias if bias.size else np.zeros(size))
        for j, weight in enumerate(self.iw[k]):
            if _filled(weight):
                total = total.plus(self._weighted(builder, k, j, weight, entered[j], "inputDelays"))
        for j in range(self.lw.shape[1]):
            if _filled(self.lw[k, j]):
                value = _of_layer(f"layer{j + 1}", self._size(j))
                total = total.plus(self._weighted(builder, k, j, self.lw[k, j], value, "layerDelays"))
        kind, name = self.transfer[k], f"layer{k + 1}"
        if kind == "purelin":
            builder.named(name, total, "linear")
        elif kind in TRANSFER:
            builder.named(name, total, TRANSFER[kind])
        elif kind in ("poslin", "satlins"):
            value = (
                builder.rectified(total, 0.0, f"{name}_n")
                if kind == "poslin"
                else builder.clipped(total, -1.0, 1.0, f"{name}_n")
            )
            builder.named(name, value, "linear")
        else:
            known = ", ".join((*TRANSFER, "poslin", "purelin", "satlins"))
            raise InputError(f"{self.path}: layer {k + 1} has transferFcn {shown(kind)}; carried are {known}")

    def _weighted(self, builder: Builder, k: int, j: int, weight: Any, value: Value, field: str) -> Value:
        """The weights of every delay, side by side, on the value so many steps before."""
        delays = self._delays(field, k, j)
        matrix = np.atleast_2d(np.asarray(weight, float))
        if matrix.shape != (self._size(k), value.size * len(delays)):
            raise InputError(
                f"{self.path}: weights of layer {k + 1} from {j + 1}: {list(matrix.shape)}; {self._size(k)} neurons "
                f"and {len(delays)} delays of {value.size} elements need {[self._size(k), value.size * len(delays)]}"
            )
        total = constant(np.zeros(self._size(k)))
        for n, delay in enumerate(delays):
            part = matrix[:, n * value.size : (n + 1) * value.size]
            total = total.plus(self._before(builder, field, j, value, delay).linear(part))
        return total

    def _before(self, builder: Builder, field: str, j: int, value: Value, delay: int) -> Value:
        """An input or a layer so many steps before, begun as Xi and Ai say; at 0 where the file has none."""
        starts = self._starts("Xi" if field == "inputDelays" else "Ai", j, value.size) if delay else []
        if not starts:
            return value.late(delay)
        if delay > len(starts):
            raise InputError(
                f"{self.path}: {len(starts)} initial states and a delay of {delay}; save Xi and Ai of preparets"
            )
        line = self.delayed.setdefault((field, j), [value])
        while len(line) <= delay:
            name, past = builder.state(f"{field[:5]}{j + 1}_delay{len(line)}", starts[len(line) - 1])
            builder.keep(name, line[-1])
            line.append(past)
        return line[delay]

    def _starts(self, field: str, j: int, size: int) -> list[np.ndarray]:
        """Of an input (Xi, in its units) or a layer (Ai): what it was before the first step, the newest first."""
        grid = np.atleast_2d(_cells(self.found.get(field, np.empty(0, object))))
        if grid.size == 0 or j >= grid.shape[0]:
            return []
        found = []
        for held in reversed(grid[j]):
            start = np.ravel(np.asarray(held, float))
            if start.size != size or not np.isfinite(start).all():
                what = f"{field}{{{j + 1},:}}: {start.size} numbers for {size} elements"
                raise InputError(f"{self.path}: {what}; save one sequence, without NaN")
            for offset, gain, low in self._steps("inputProcess", j) if field == "Xi" else ():
                start = (start - offset) * gain + low
            found.append(start)
        return found

    # -- processing: y = (x - xoffset) * gain + ymin -----------------------------------------------------------------

    def _steps(self, field: str, k: int) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """(xoffset, gain, ymin) of each setting, in the order of the input side."""
        given = _cells(self.found.get(field, np.empty(0, object))).ravel()
        if k >= len(given) or not _filled(given[k]):
            return []
        settings = given[k]
        settings = [settings] if isinstance(settings, Mapping) else [s for s in _cells(settings).ravel() if _filled(s)]
        found = []
        for s in settings:
            if not isinstance(s, Mapping):
                raise InputError(
                    f"{self.path}: {field}{{{k + 1}}} holds {shown(s)}; give processSettings, a struct each"
                )
            if {"xoffset", "gain"} <= set(s):
                low = s.get("ymin", s.get("ymean", 0.0))
                offset, gain, least = (np.ravel(np.asarray(v, float)) for v in (s["xoffset"], s["gain"], low))
                found.append((offset, gain, least))
            elif not (s.get("no_change") is not None and np.all(s["no_change"])):
                raise InputError(
                    f"{self.path}: {field}{{{k + 1}}} is of a function that is not carried; use mapminmax or mapstd, "
                    "or remove the others before training"
                )
        return found


def _of_layer(name: str, size: int) -> Value:
    """A layer's output now."""
    return Value((size,), np.zeros(size), {(name, 0): np.eye(size)})


def _layered(found: Mapping[str, Any]) -> Mapping[str, Any]:
    """The fields of a network of plain layers, W{i}, b{i} and act_fcns{i}, as those of a toolbox network."""
    if "IW" in found or not {"W", "b", "act_fcns"} <= found.keys():
        return found
    weights, names = _cells(found["W"]).ravel(), [str(v).strip() for v in _cells(found["act_fcns"]).ravel()]
    within = np.full((len(weights), len(weights)), None, object)
    for k in range(1, len(weights)):
        within[k, k - 1] = weights[k]
    entering = np.full((len(weights), 1), None, object)
    entering[0, 0] = weights[0]
    transfer = np.array([PLAIN.get(n.lower(), n) for n in names], object)
    return {**found, "IW": entering, "LW": within, "transferFcn": transfer}


# -- what the file holds ---------------------------------------------------------------------------------------------


def _cells(value: Any) -> np.ndarray:
    """A cell array; a single value is one of one cell."""
    if isinstance(value, np.ndarray) and value.dtype == object:
        return value
    if isinstance(value, list):
        found = np.empty(len(value), object)
        found[:] = value
        return found
    found = np.empty(1, object)
    found[0] = value
    return found


def _filled(value: Any) -> bool:
    return value is not None and (isinstance(value, Mapping) or np.size(value) > 0)


def _read(path: Path) -> dict[str, Any]:
    """The variables of the file; those of a lone struct, if it holds nothing else."""
    found = read_mat(path)
    if len(found) == 1 and isinstance(alone := next(iter(found.values())), Mapping):
        return dict(alone)
    return found
