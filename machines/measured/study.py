"""The studies on measured recordings: which runs train and test, which structures compete (identify/study.py)."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from greygate.errors import InputError
from greygate.identify.study import Fold, Runs, Structure, Study, blocked, masked, tails
from greygate.machines.measured.axis import axis, moving, starting
from greygate.machines.measured.crane import crane
from greygate.machines.measured.drives import PULSES, VOLTAGE, drives
from greygate.machines.measured.tanks import LEVEL, PUMP, pumped, tanks
from greygate.models.families.regression import noe
from greygate.models.network import Network, Port
from greygate.models.training.initial import initialised, resting
from greygate.models.training.levenberg import Trained, train
from greygate.models.training.record import Record
from greygate.plants.recording import Recording, read_csv


def _record(recording: Recording, inputs: Sequence[str], output: str) -> Record:
    return Record({n: recording[n] for n in inputs}, {output: recording[output]})


def _fit(network: Network, records: Sequence[Record], **options) -> Trained:
    return train(network, list(records), **options)


def _linear(name: str, inputs: Mapping[Port, Sequence[int]], output: Port, feedback: Sequence[int], **options):
    """Linear output-error model, trained from the weights of the ARX model. options: of `train`."""

    def fit(network: Network, records: Sequence[Record]) -> Trained:
        return _fit(_fit(network, records, teacher=True, **options).network, records, **options)

    return Structure(lambda seed: noe(name, inputs, output, feedback), fit)


def _hammerstein(
    hidden: int, name: str, inputs: Mapping[Port, Sequence[int]], output: Port, feedback: Sequence[int], **options
) -> dict[str, Structure]:
    """`hidden` neurons on the inputs beside a linear model, trained from the linear model of the same orders."""

    def build(seed: int) -> Network:
        return noe(name, inputs, output, feedback, (hidden,), seed, linear_loop=True)

    return {f"{hidden} neurons": Structure(build, partial(_fit, **options), grown=True)}


# ---- servo-hydraulic test machine


def _mts(folder: Path) -> tuple[dict[str, Record], dict[str, Record]]:
    """Train without coil current (0A), test with 1 A, which is another load; complete runs, 1 kHz."""

    def run(name: str) -> Record:
        return _record(read_csv(folder / f"mts_{name}.csv", {"x_cmd": "m", "x_meas": "m"}), ["x_cmd"], "x_meas")

    return {n: run(n) for n in ("chirp_0A", "15Hz0A")}, {n: run(n) for n in ("chirp_1A", "15Hz1A")}


_MTS = (
    "mts",
    {Port("x_cmd", "m", 2.048e-3, -2.048e-3): range(1, 20, 3)},
    Port("x_meas", "m", 2.048e-3, -2.048e-3),
    (1, 4),
)
MTS = Study(
    "mts",
    "servohydraulic-mts",
    "github.com/DanielMaurelE/vRTHS_AMBC_MRdamper",
    _mts,
    _linear(*_MTS, decay=1e-3, epochs=60),
    _hammerstein(4, *_MTS, decay=1e-3, epochs=60),
    seeds=range(24),
    folds=tails(0.2),
    period=1e-3,
)
"""The machine's displacement from its command, 1 kHz (D. Maurel, M. Quiroz, UTFSM 2022; lag of about 17 ms).

Of ten seeds one is good on the tail of the chirp; the others extrapolate its highest frequencies badly.
"""


# ---- crane


def _crane(folder: Path) -> tuple[dict[str, Record], dict[str, Record]]:
    """Samples 1-512 train; the test is the free run from sample 1, of which 513-1024 count.

    The file states neither units nor period; x_arm is not used.
    """
    path = folder / "actuator.csv"
    unstated = dict.fromkeys(("u_valve", "p_oil", "x_arm"), "1")
    recording = read_csv(path, {"u_valve": "1", "p_oil": "1"}, units=unstated, dt=1.0)
    if recording.samples != 1024:
        raise InputError(f"{path}: {recording.samples} samples; the split needs the published 1024")
    whole = _record(recording, ["u_valve"], "p_oil")
    return {"train": whole.cut(0, 512)}, {"test": replace(whole, skip=512)}


def _crane_folds(runs: Runs) -> list[Fold]:
    """Eight blocks; the run into each starts at the first sample, as in the test."""
    (run,) = runs.values()
    ends = [len(run) * i // 8 for i in range(9)]
    return [
        replace(fold, blocks=[run.cut(0, stop, skip=start)])
        for fold, (start, stop) in zip(blocked(8, 0)(runs), pairwise(ends), strict=True)
    ]


def _crane_fit(network: Network, records: Sequence[Record]) -> Trained:
    """Fit pieces: one from the middle has an unknown initial state, while the run itself starts from rest."""
    return _fit(network, records, decay=0.02, epochs=200, estimate_initial=any(r.initial for r in records))


CRANE = Study(
    "crane",
    "hydraulic-actuator-crane",
    "github.com/zhenwendai/RGP, datasets/system_identification/actuator.mat",
    _crane,
    Structure(lambda seed: crane(0, 0), _crane_fit),
    {
        f"friction {n}, delay {d}": Structure(partial(crane, 1, n, d), _crane_fit)
        for n, d in ((0, 4), (1, 3), (1, 4), (1, 5), (1, 6))
    },
    seeds=range(6),
    folds=_crane_folds,
    period=1.0,
)
"""Oil pressure from valve opening (Sjoberg 1995)."""

# ---- linear axis

BLOCKS, WINDOW = 5, 20


def _emps(folder: Path) -> tuple[dict[str, Record], dict[str, Record]]:
    """The same motion twice, the second time with pulses of force; the first samples give the initial state of each."""

    def run(name: str) -> Record:
        recording = read_csv(folder / f"{name}.csv", {"force": "N", "q_meas": "m"})
        record = Record({"f_motor": recording["force"]}, {"position": recording["q_meas"]})
        return moving(record, 0, len(record), WINDOW)

    return {"train": run("emps_train")}, {"test": run("emps_test_pulses")}


def _emps_folds(runs: Runs) -> list[Fold]:
    """Five blocks of 5 s; its first samples and the force before it give the initial state of each piece and block."""
    (run,) = runs.values()
    ends = [len(run) * i // BLOCKS for i in range(BLOCKS + 1)]
    found = []
    for start, stop in pairwise(ends):
        kept = [(a, b) for a, b in ((0, start), (stop, len(run))) if b > a]
        pieces, blocks = ([moving(run, a, b, WINDOW) for a, b in of] for of in (kept, [(start, stop)]))
        found.append(Fold(pieces, blocks))
    return found


def _with_residual(hidden: int) -> Callable[[int], Network]:
    return lambda seed: axis(hidden=hidden, seed=seed)


def _emps_fit(network: Network, records: Sequence[Record], free=None) -> Trained:
    fit = train(network, list(records), epochs=60, free=free)
    return replace(fit, network=starting(fit.network, records[0]))


EMPS = Study(
    "emps",
    "emps",
    "nonlinearbenchmark.org (EMPS; A. Janot, M. Gautier, M. Brunot, 2019)",
    _emps,
    Structure(
        lambda seed: axis(coulomb=0.0),
        partial(_emps_fit, free={f"balance.{part}": np.zeros(1, bool) for part in ("sign", "forward")}),
    ),
    {f"residual {n}": Structure(_with_residual(n), _emps_fit) for n in (0, 2, 4)},
    seeds=range(3),
    folds=_emps_folds,
    period=1e-3,
)
"""Position of a ball-screw axis from the force of its motor, free run over 25 s.

No state slower than the record is a candidate: one record cannot tell what starts anew with each run from what drifts
on.
"""

# ---- cascaded tanks


def _tanks(folder: Path) -> tuple[dict[str, Record], dict[str, Record]]:
    """1024 samples each, 4 s. The test run's first five samples are for its initial levels and do not count."""
    path = folder / "cascaded_tanks.csv"
    recording = read_csv(path, {f"{s}_{run}": "V" for s in "uy" for run in ("train", "test")})

    def run(name: str, skip: int) -> Record:
        u, y = recording[f"u_{name}"], recording[f"y_{name}"]
        return Record({"u": u}, {"y": y}, {"u": u[0]}, skip)

    return {"train": run("train", 0)}, {"test": run("test", 5)}


def _tanks_fit(network: Network, records: Sequence[Record]) -> Trained:
    """The lowest loss from three pump gains, because the first overflow of the upper tank decides the minimum found."""
    starts = [pumped(network, factor) for factor in (0.7, 1.0, 1.4)]
    fits = [train(start, list(records), estimate_initial=True, decay=1e-2, epochs=200) for start in starts]
    fit = min(fits, key=lambda fit: fit.history[-1])
    return replace(fit, network=resting(fit.network, fit.initial[0]))


TANKS = Study(
    "tanks",
    "cascaded-tanks",
    "nonlinearbenchmark.org (Cascaded tanks; M. Schoukens, P. Mattson, T. Wigren, J.-P. Noel, 2016)",
    _tanks,
    _linear("tanks", {PUMP: (1, 2)}, LEVEL, (1, 2), epochs=200, estimate_initial=True),
    {
        "plain": Structure(partial(tanks, rim=False, widening=False), _tanks_fit),
        "rim": Structure(partial(tanks, widening=False), _tanks_fit),
        "widening": Structure(partial(tanks, rim=False), _tanks_fit),
        "rim, widening": Structure(tanks, _tanks_fit),
        "rim, widening, delay 0": Structure(partial(tanks, delay=0), _tanks_fit),
        "rim, widening, exchange 1": Structure(partial(tanks, exchange=1), _tanks_fit),
        "rim, widening, exchange 2": Structure(partial(tanks, exchange=2), _tanks_fit),
    },
    seeds=range(4),
    folds=blocked(8, 20),
    period=4.0,
    start=initialised,
)
"""Level of the lower of two tanks from the voltage of the pump that fills the upper one."""

# ---- coupled electric drives


def _ced(folder: Path) -> tuple[dict[str, Record], dict[str, Record]]:
    """Two runs of 500 samples, 50 Hz, each from standstill. A test run goes on from the 300 samples trained on."""
    path = folder / "ced_unif.csv"
    recording = read_csv(path, {f"{s}{i}": unit for s, unit in (("u", "V"), ("z", "tick/s")) for i in (11, 12)})
    runs = {n: Record({"u": recording[f"u{i}"]}, {"z": recording[f"z{i}"]}) for n, i in (("low", 11), ("high", 12))}
    return {n: r.cut(0, 300) for n, r in runs.items()}, {f"{n}_test": replace(r, skip=300) for n, r in runs.items()}


CED = Study(
    "ced",
    "ced",
    "nonlinearbenchmark.org (Coupled electric drives, DATAUNIF; T. Wigren, M. Schoukens, 2017)",
    _ced,
    _linear("ced", {VOLTAGE: (1, 2, 3)}, PULSES, (1, 2, 3), epochs=200),
    {
        name: Structure(partial(drives, **options), partial(_fit, decay=1e-4, epochs=200))
        for name, options in {
            "friction 2": {"friction": 2},
            "friction 3": {"friction": 3},
            "friction 2, order 4": {"friction": 2, "order": 4},
            "friction 2, counter 2": {"friction": 2, "counter": 2},
            "friction 2, drive 2": {"friction": 2, "drive": 2},
            "friction 2, counter 2, order 4": {"friction": 2, "counter": 2, "order": 4},
        }.items()
    },
    seeds=range(8),
    folds=masked(5),
    period=0.02,
    typical=min,  # as when it was chosen and scored (docs/measured.md)
)
"""Speed of a belt's pulley, as a pulse counter sees it, from the voltage of the motors."""

STUDIES = {study.name: study for study in (MTS, CRANE, EMPS, TANKS, CED)}
