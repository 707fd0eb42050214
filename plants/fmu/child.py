"""The process in which an FMU runs: it answers on stdout what comes on stdin (`pipe`), until stdin ends.

It holds one instance at a time. What the FMU prints goes nowhere; what it logs is told with an error.
"""

import ctypes
import os
import re
import sys
import types
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
from fmpy import fmi2, fmi3
from fmpy.fmi1 import FMICallException

from greygate.errors import one_line
from greygate.generated import load
from greygate.plants.fmu.loop import memory
from greygate.plants.fmu.pipe import receive, send

LOGGED = 150  # characters of what an FMU logs, that are told
WORSE = 1  # status above which a log entry is kept in place of an earlier one
POINTS = 4  # of state, input and time at which equations are looked at
FEWEST = 3  # of these, at least: from fewer nothing is said
SPREAD = 0.1  # of a nominal value, by which these lie around the start
LATER = 0.3719  # s between them: a time at which nothing comes back
OFF, SMALLER = 0.05, 10  # of a parameter, by which it is another there; times less where the FMU refuses that
NUDGE = 1e-6  # of a nominal value, for a slope
ROUNDS = 100  # of an event, at most


Numbers = Sequence[float] | np.ndarray
Arrays = Mapping[str, np.ndarray]
Looks = list[tuple[np.ndarray, ...]]


class Refused(Exception):
    """The FMU does not do what it was asked for."""


class Unit:
    """A loaded FMU. about: what the parent found in its description (`unit.Facts`)."""

    def __init__(self, about: Mapping[str, Any]):
        self.about, self.version, self.logged = about, about["version"], ""
        kinds = {
            (2, False): fmi2.FMU2Model, (2, True): fmi2.FMU2Slave, (3, False): fmi3.FMU3Model, (3, True): fmi3.FMU3Slave
        }  # fmt: skip
        self.fmu = kinds[self.version, about["stepped"]](
            guid=about["token"], unzipDirectory=about["folder"], modelIdentifier=about["identifier"],
            instanceName="greygate", libraryPath=about["library"], requireFunctions=False,
        )  # fmt: skip
        self.live = False
        self.modules: dict[str, types.ModuleType] = {}
        if self.version == 2:
            self.calls = fmi2.fmi2CallbackFunctions()
            self.calls.logger = fmi2.fmi2CallbackLoggerTYPE(self._logged)
            self.calls.allocateMemory = fmi2.defaultCallbacks.allocateMemory
            self.calls.freeMemory = fmi2.defaultCallbacks.freeMemory
            fmi2.addLoggerProxy(ctypes.byref(self.calls))

    def _logged(self, *words: Any) -> None:
        texts = [w for w in words if isinstance(w, bytes)]
        numbers = [w for w in words if isinstance(w, int)]
        if texts and (not self.logged or (numbers and numbers[-1] > WORSE)):
            self.logged = one_line(" ".join(texts[-1].decode("utf-8", "replace").split()))[:LOGGED]

    # -- an instance ---------------------------------------------------------------------------------------------------

    def fresh(self, values: Numbers, given: Numbers = (), begin: Mapping[int, float] | None = None) -> None:
        """A new instance with parameters and first inputs, initialised. begin: reference of a state -> its start."""
        self.end()
        self.logged = ""
        try:
            if self.version == 2:
                self.fmu.instantiate(callbacks=self.calls, loggingOn=True)
            else:
                self.fmu.instantiate(loggingOn=True, logMessage=lambda _, status, __, text: self._logged(text, status))
        except Exception:
            raise Refused(f"makes no instance ({self.logged or 'it says nothing'})") from None
        self.live = True
        self.set(self.about["parameters"], values)
        self.set(self.about["inputs"], given)
        for reference, value in (begin or {}).items():
            with suppress(FMICallException):  # not every state is set so
                self.set([reference], [value])
        if self.version == 2:
            self.fmu.setupExperiment(startTime=self.about["from"])
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(startTime=self.about["from"])
        self.fmu.exitInitializationMode()
        self.next = np.inf
        if not self.about["stepped"]:
            for _ in range(ROUNDS):
                again, stop, _, _, defined, moment = (
                    self.fmu.newDiscreteStates() if self.version == 2 else self.fmu.updateDiscreteStates()
                )
                self.next = float(moment) if defined else np.inf
                if stop:
                    raise Refused(f"ends at its start ({self.logged or 'it says nothing'})")
                if not again:
                    break
            self.fmu.enterContinuousTimeMode()

    def end(self) -> None:
        if self.live:
            self.live = False
            (self.fmu.fmi2FreeInstance if self.version == 2 else self.fmu.fmi3FreeInstance)(self.fmu.component)

    def set(self, references: Sequence[int], values: Numbers) -> None:
        if len(values):
            (self.fmu.setReal if self.version == 2 else self.fmu.setFloat64)(list(references), list(map(float, values)))

    def get(self, references: Sequence[int]) -> np.ndarray:
        if not len(references):
            return np.empty(0)
        return np.array((self.fmu.getReal if self.version == 2 else self.fmu.getFloat64)(list(references)))

    # -- what it is ----------------------------------------------------------------------------------------------------

    def asked(self) -> dict[str, Any]:
        """What only a running FMU tells; see `unit.Asked`."""
        about = self.about
        values = about["values"]
        self.fresh(values)
        found = {"inputs": self.get(about["inputs"]).tolist(), "start": [], "next": bool(np.isfinite(self.next))}
        if about["stepped"]:
            self.start = []
            return found | {"rates": {}, "same": {}, "fastest": 0.0, "timed": False}
        start, given = self._vector("states"), np.array(found["inputs"])
        nominal = np.abs(self._vector("nominals"))
        fastest, timed, looks = (
            self._fastest(start, nominal),
            self._timed(start, given),
            self._looks(start, given, nominal),
        )
        looks = self._otherwise(looks, lambda: self._looks(start, given, nominal))
        n = range(len(start))
        shown = range(len(about["shown"]))
        rates = {i: j for i in n for j in n if looks and i != j and all(dx[i] == x[j] for x, dx, _ in looks)}
        same = {i: j for i in shown for j in n if looks and all(y[i] == x[j] for x, _, y in looks)}
        found["start"] = self.start = _out(start, about["scales"]["states"]).tolist()
        return found | {"rates": rates, "same": same, "fastest": fastest, "timed": timed}

    def _timed(self, start: np.ndarray, given: np.ndarray) -> bool:
        """Whether what it computes depends on time itself."""
        now = self._at(self.about["from"], start, given)
        with suppress(FMICallException):
            later = self._at(self.about["from"] + LATER, start, given)
            return any(not np.array_equal(a, b) for a, b in zip(later, now, strict=True))
        return True

    def _otherwise(self, looks: Looks, look: Callable[[], Looks]) -> Looks:
        """The looks, and those with other parameters: nothing may be so by their values alone. None where too few."""
        values = self.about["values"]
        for size in (OFF, OFF / SMALLER, OFF / SMALLER**2) if values else ():
            with suppress(FMICallException, Refused):  # it may not stand them
                self.fresh([v * (1 + size * (1 + i / len(values))) if v else size for i, v in enumerate(values)])
                more = look()
                return looks + more if len(more) >= FEWEST <= len(looks) else []
        return [] if values or len(looks) < FEWEST else looks

    def _looks(self, start: np.ndarray, given: np.ndarray, nominal: np.ndarray) -> Looks:
        """(states, their rates, outputs) at some points."""
        rng, found = np.random.default_rng(0), list[tuple[np.ndarray, ...]]()
        for k in range(POINTS):
            x = start + SPREAD * nominal * rng.standard_normal(len(start))
            u = given + SPREAD * np.maximum(np.abs(given), 1.0) * rng.standard_normal(len(given))
            with suppress(FMICallException):  # outside of where it is defined
                found.append((x, *self._at(self.about["from"] + k * LATER, x, u)))
        return found

    def _at(self, t: float, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(rates, outputs)."""
        self.fmu.setTime(t)
        self.set(self.about["inputs"], u)
        array = (ctypes.c_double * len(x))(*x)
        if len(x):
            self.fmu.setContinuousStates(array, len(x))
        return self._vector("rates"), self.get(self.about["shown"])

    def _vector(self, what: str) -> np.ndarray:
        """The states, their rates or their nominal values."""
        n = len(self.about["states"])
        names = {
            "states": ("getContinuousStates", "getContinuousStates"),
            "rates": ("getDerivatives", "getContinuousStateDerivatives"),
            "nominals": ("getNominalsOfContinuousStates", "getNominalsOfContinuousStates"),
        }
        array = (ctypes.c_double * max(n, 1))()
        if n:
            getattr(self.fmu, names[what][self.version - 2])(array, n)
        return np.array(array[:n])

    def _fastest(self, x: np.ndarray, nominal: np.ndarray) -> float:
        """The largest magnitude of an eigenvalue of the rates' slopes, 1/s."""
        about, columns = self.about, []
        if not len(x):
            return 0.0
        u = self.get(about["inputs"])
        base, _ = self._at(about["from"], x, u)
        for j in range(len(x)):
            if about["directional"]:
                columns.append(np.array(self.fmu.getDirectionalDerivative(about["rates"], [about["states"][j]], [1.0])))
                continue
            step = NUDGE * max(nominal[j], abs(x[j]))
            moved, _ = self._at(about["from"], x + step * (np.arange(len(x)) == j), u)
            columns.append((moved - base) / step)
        slopes = np.stack(columns, axis=1)
        return float(np.abs(np.linalg.eigvals(slopes)).max()) if np.isfinite(slopes).all() else np.inf

    # -- how it moves --------------------------------------------------------------------------------------------------

    def compiled(self, text: str) -> types.ModuleType:
        """The module of a source, which finds the FMU's functions."""
        if text not in self.modules:
            from llvmlite import binding

            for name in re.findall(r'ExternalFunction\(\s*"(\w+)"', text):
                try:
                    function = getattr(self.fmu.dll, name)
                except AttributeError:
                    raise Refused(f"has no function {name}, which its description promises") from None
                binding.add_symbol(name, ctypes.cast(function, ctypes.c_void_p).value)
            self.modules[text] = load("plant", text)
        return self.modules[text]

    def run(self, asked: Mapping[str, Any], a: Arrays) -> tuple[dict[str, Any], Arrays]:
        """`pieces` of a source that was given; states (samples, states)."""
        about, loop, added = self.about, self.compiled(asked["loop"]), self.compiled(asked["source"])
        on = added.asked(a["parameters"]).view(np.uint8)
        terms = added.all_terms if on.any() else added.few_terms
        columns, starts = np.array(asked["columns"], np.int64), a["starts"]
        n, scales = len(about["states"]), about["scales"]
        given = _into(a["inputs"][0, columns], scales["inputs"])
        wanted = _into(starts[0, :n], scales["states"])
        begin = {r: x for r, x, s, own in zip(about["states"], wanted, starts[0], self.start, strict=False) if s != own}
        self.fresh(asked["values"], given, begin)
        own = _out(self._vector("states"), scales["states"]) if n else np.empty(0)
        for j in range(n):
            if about["states"][j] not in begin:
                starts[0, j] = own[j]
        rows: dict[str, Numbers] = {"IN": given, "STATE": np.zeros(n), "NEXT": [self.next], "TIME": [about["from"]]}
        for end, pairs in (("_IN", scales["inputs"]), ("_OUT", asked["scales"]), ("", scales["states"])):
            rows[f"SCALE{end}"], rows[f"LEVEL{end}"] = _pairs(pairs).T
        at = memory(
            self._address(), terms.address, on, columns, about["inputs"], asked["shown"], about["indicators"], rows,
            self.version == 2,
        )  # fmt: skip
        out = np.full((len(a["inputs"]), starts.shape[1]), np.nan)
        failed = loop.pieces(
            starts, a["restarts"], a["reset"], a["inputs"], a["parameters"], a["low"], a["high"], a["rate"],
            asked["step"], asked["substeps"], out, at,
        )  # fmt: skip
        return {"failed": int(failed), "logged": self.logged}, {"out": out}

    def _address(self) -> int:
        component = self.fmu.component
        return int(getattr(component, "value", component))


def _pairs(scales: Sequence[Sequence[float]]) -> np.ndarray:
    return np.array(scales, float).reshape(-1, 2)


def _out(values: np.ndarray, scales: Sequence[Sequence[float]]) -> np.ndarray:
    """The FMU's numbers in the plant's units."""
    pairs = _pairs(scales)
    return np.asarray(values) * pairs[:, 0] + pairs[:, 1]


def _into(values: np.ndarray, scales: Sequence[Sequence[float]]) -> np.ndarray:
    """The plant's numbers in the FMU's units."""
    pairs = _pairs(scales)
    return (np.asarray(values) - pairs[:, 1]) / pairs[:, 0]


def main() -> int:
    said = os.fdopen(os.dup(1), "wb")
    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 1)
    os.dup2(nothing, 2)
    unit = None
    while True:
        try:
            asked, arrays = receive(sys.stdin.buffer)
        except EOFError:
            return 0
        try:
            match asked["ask"]:
                case "open":
                    unit = Unit(asked["about"])
                    send(said, unit.asked())
                case "run":
                    assert unit is not None
                    send(said, *unit.run(asked, arrays))
        except Exception as error:  # of fmpy, too
            logged = unit.logged if unit is not None else ""
            why = str(error) if isinstance(error, Refused) or not logged else f"{error} ({logged})"
            own = isinstance(error, Refused | FMICallException)
            send(said, {"error": one_line(" ".join(why.split())), "own": own})


if __name__ == "__main__":
    sys.exit(main())
