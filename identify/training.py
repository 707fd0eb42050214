"""Training of a user's network on recordings, from one start or several: what comes of it, as figures and files."""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, NotRequired, TypedDict

import numpy as np

from greygate.errors import InputError
from greygate.files import making, replacing, writing
from greygate.identify.baseline import linear_rms
from greygate.identify.sensors import own_sensors
from greygate.identify.settling import settling
from greygate.identify.trained import Evidence, EvidenceFigures, evidence
from greygate.models.accuracy import Errors, free_run_rms, pooled_rms, rms
from greygate.models.families.blocks import nguyen_widrow
from greygate.models.linearised import linearised
from greygate.models.network import Network
from greygate.models.training.initial import initialised
from greygate.models.training.levenberg import Outcome, Start, Trained, multistart, narx_noe, train
from greygate.models.training.record import Record, held_out
from greygate.plain import SOME, Count, Figure, json_text, plain
from greygate.progress import Progress, silent, titled

ALIKE = 1.05  # factor between the held-out errors of the two best starts, up to which they end alike
APART = 1.5  # factor from which the best one is luck
CHECKPOINTS = ("", ".narx", ".shooting")


class Run(TypedDict):
    outcome: str
    sentence: str
    epochs: Count
    loss: Figure
    seconds: float
    history: Annotated[list[Figure], "Loss after each epoch, from epoch 0 on."]
    held: Annotated[list[Figure], "RMS on what is held out after each epoch, normalised; empty where nothing is."]


class StartFigures(Run):
    """held_out: RMS over everything held out, normalised. pole: modulus of the slowest one."""

    start: Count
    held_out: Figure
    pole: float | None


class Training(Run):
    """How a network of yours was trained. RMSE in free run, in the output's unit; null where it diverges."""

    rmse: Annotated[Errors, "Recording -> output -> RMSE."]
    linear: Annotated[Errors, "The same of a linear model of the same orders."]
    remarks: list[str]
    settle: Annotated[Count, "First samples that only give the initial state."]
    offsets: Annotated[
        dict[str, dict[str, float]],
        "Recording -> output -> measured less predicted, in its unit, where the offset is the recording's own.",
    ]
    gains: NotRequired[
        Annotated[
            dict[str, dict[str, float]],
            "Recording -> output -> measured over predicted, where the gain is the recording's own.",
        ]
    ]
    starts: Annotated[list[StartFigures], SOME, "The chosen one first."]
    evidence: Annotated[
        EvidenceFigures,
        "About the chosen start: what moved, its linearisation, how well weights are known, residual tests of the free "
        "run.",
    ]
    out: str


def train_records(
    network: Network,
    records: Mapping[str, Record],
    others: Mapping[str, Record],
    folder: Path,
    *,
    settle: int | None = 0,
    narx: bool = True,
    seeds: int = 1,
    jobs: int = 2,
    offset: Sequence[str] = (),
    gain: Sequence[str] = (),
    html: Path | None = None,
    page: Callable[[dict, Evidence], str] | None = None,
    seconds: float = math.inf,
    progress: Progress = silent,
    **options,
) -> dict:
    """Train a network on records of its sample time, and write it with the returned figures into the folder.

    others: held-out records, which choose the epoch. settle: first samples of each record that only give its initial
    state, which is then estimated, in training and for the figures; None: as many as `settling` finds. narx: train the
    one-step prediction first. seeds: starts, of which the first has the weights of the network and the others draw
    those of the neurons; what is held out chooses one. jobs: starts side by side. offset, gain: outputs whose sensor
    has an offset, a gain, of its own in every record but the first. html: a page of the same to write, which `page`
    makes (`greygate.pages.training.page`). seconds: for all starts together. options: of `train`. Raises InputError as
    `train`, before anything is written.
    """
    if (period := network.sample_time()) is None:
        raise InputError(f"network {network.name}: does not say its sample time; give it one (dt)")
    tail = options.get("tail", 0.0)
    if seeds > 1 and not (others or tail):
        raise InputError(
            f"--seeds {seeds}: nothing is held out that could choose a start; give --held FILE.csv or --tail 0.2"
        )
    records, others = _own(network, records, others, offset, gain)
    remarks = []
    if settle is None:
        chosen = settling(network, records)
        settle = chosen.samples
        remarks.append(f"--settle {chosen.samples}: {chosen.why}")
    records, others = ({n: replace(r, skip=settle) for n, r in of.items()} for of in (records, others))
    begun = [network, *(drawn(network, seed) for seed in range(1, seeds))]
    path = folder / f"{network.name}.checkpoint"
    paths = [path if seeds == 1 else path.with_suffix(f".start{seed}.checkpoint") for seed in range(seeds)]
    learn = narx_noe if narx and not options.get("shooting") else train
    fit = partial(
        learn,
        records=list(records.values()),
        held=list(others.values()),
        keep=True,
        estimate_initial=settle > 0,
        seconds=seconds / math.ceil(seeds / jobs),
        **options,
    )

    def started(seed: int) -> Trained:
        told = progress if seeds == 1 else titled(progress, f"start {seed}")
        return fit(begun[seed], checkpoint=paths[seed], progress=told)

    def held_error(trained: Network) -> float:
        """RMS over everything held out, normalised."""
        judges = [r for n, r in _judged(trained, records, others, tail).items() if n not in records]
        return rms(pooled_rms(trained, judges)) if judges else math.nan

    with ExitStack() as place:
        drawn_page = None if html is None else place.enter_context(replacing(html))  # before hours of work, not after
        with making(folder), writing(folder):
            if seeds == 1:
                found = started(0)
                starts = [Start(0, found, held_error(found.network))]
            else:
                starts = multistart(started, held_error, range(seeds), jobs, progress)
        trained = network.with_parameters(starts[0].fit.network.parameters())  # not flat: modules stay as declared
        sensors = {n: own_sensors(trained, r) for n, r in (records | others).items() if r.own_offset or r.own_gain}
        judged = _judged(trained, records, others, tail)
        known = [judged[name] for name in records]
        learnt = held_out(trained, known, tail, ())[0]
        shown = evidence(network, trained, learnt, judged, period, options.get("decay", 0.0))
        figures = plain(
            {
                **_told(starts[0].fit),
                "rmse": {name: free_run_rms(trained, record) for name, record in judged.items()},
                "linear": linear_rms(list(records.values()), records | others),
                "remarks": [*remarks, *starts[0].fit.remarks, *of_starts(starts)],
                "settle": settle,
                "offsets": {n: s.told(trained)[1] for n, s in sensors.items() if offset},
                "gains": {n: s.told(trained)[0] for n, s in sensors.items() if gain},
                "starts": [_start(s, known[0]) for s in starts],
                "evidence": shown.figures(),
                "out": str(folder / f"{network.name}.toml"),
            }
        )
        if drawn_page is not None and page is not None:
            drawn_page.write_text(page(figures, shown), encoding="utf-8", newline="\n")
        trained.save(folder / network.name, json_text(figures))
    if not any(s.fit.outcome in (Outcome.INTERRUPTED, Outcome.TIME) for s in starts):
        for left in (f"{p}{suffix}" for p in paths for suffix in CHECKPOINTS):
            Path(left).unlink(missing_ok=True)
    return figures


def _judged(
    network: Network, records: Mapping[str, Record], others: Mapping[str, Record], tail: float
) -> dict[str, Record]:
    """Every record and held-out tail, without its own offsets and gains, from the state that fits its beginning."""
    level = {n: own_sensors(network, r).undone(r) for n, r in (*records.items(), *others.items())}
    found = {name: initialised(network, record) for name, record in level.items()}
    ends = held_out(network, list(records.values()), tail, ())[1]
    return found | {f"{n} tail": replace(found[n], skip=e.skip) for n, e in zip(records, ends, strict=False)}


def _own(
    network: Network,
    records: Mapping[str, Record],
    others: Mapping[str, Record],
    offset: Sequence[str],
    gain: Sequence[str],
) -> tuple[dict[str, Record], dict[str, Record]]:
    """The records, with offsets and gains of these outputs of their own; the others are compared to the first."""
    known = [p.name for p in network.outputs]
    for option, name in (*(("--offset", n) for n in offset), *(("--gain", n) for n in gain)):
        if name not in known:
            raise InputError(f"{option} {name}: {network.name} has no such output; it has {', '.join(known)}")
        if len(records) + len(others) < 2:
            raise InputError(f"{option} {name}: the first recording is the reference; give another one beside it")
    first = next(iter(records))

    def own(record: Record) -> Record:
        return replace(record, own_offset=frozenset(offset), own_gain=frozenset(gain))

    given = {n: r if n == first else own(r) for n, r in records.items()}
    return given, {n: own(r) for n, r in others.items()}


def drawn(network: Network, seed: int) -> Network:
    """The network with new weights of its neurons, as `nguyen_widrow` draws them; library networks stay as they are.

    Raises InputError for a network without a neuron that can be drawn: all of its starts would be one.
    """
    own = network.parameters()
    known = tuple(f"{path}." for path in _library(network))
    new = nguyen_widrow(network, seed).parameters()
    moved = {n: v for n, v in new.items() if n in own and not n.startswith(known) and not np.array_equal(v, own[n])}
    if not moved:
        raise InputError(f"network {network.name}: has no neurons to draw, so all starts are one; leave out --seeds")
    return network.with_parameters(moved)


def _library(network: Network, prefix: str = "") -> list[str]:
    """Paths of the modules that have a meaning."""
    found = []
    for name, module in network.modules.items():
        if isinstance(module, Network):
            path = f"{prefix}{name}"
            found += [path] if module.meaning else _library(module, f"{path}.")
    return found


def _told(fit: Trained) -> Run:
    """How a training went. held: root mean square by epoch, normalised."""
    return {
        "outcome": fit.outcome.name.lower(),
        "sentence": fit.outcome.value,
        "epochs": len(fit.history) - 1,
        "loss": fit.history[-1],
        "seconds": round(fit.seconds, 2),
        "history": list(fit.history),
        "held": [math.sqrt(v) for v in fit.held],
    }


def _start(start: Start, record: Record) -> StartFigures:
    """One start, for the comparison of all. pole: modulus of the slowest one, about the means of the record."""
    about = linearised(start.fit.network, record)
    poles = np.abs(about.poles()) if about else np.zeros(0)
    slowest = float(poles[0]) if len(poles) else None
    return {"start": start.seed, **_told(start.fit), "held_out": start.score, "pole": slowest}


def of_starts(starts: Sequence[Start]) -> list[str]:
    """What the starts say together, a sentence each with what to do; `starts` are ranked."""
    if len(starts) < 2:
        return []
    found, (first, second) = [], starts[:2]
    if wild := [s.seed for s in starts if s.fit.outcome is Outcome.DIVERGED or not math.isfinite(s.score)]:
        found.append(f"{len(wild)} of {len(starts)} starts diverge: try --decay 1e-4, or --shooting 40")
    if second.score > APART * first.score:
        found.append(f"the next start errs {second.score / first.score:.2g} times as much: give more --seeds")
    elif second.score <= ALIKE * first.score:
        found.append("the two best starts end alike: more --seeds would hardly help")
    found.append(
        "held-out data chose the epoch and the start, so their error flatters: judge on another recording with "
        "greygate validate"
    )
    return found


def table(starts: Sequence[Mapping]) -> list[dict[str, str]]:
    """The rows of `pages.summary.aligned`: one for each entry of the figures' `starts`, the chosen one first."""

    def cell(value: float | None) -> str:
        return "–" if value is None else f"{value:.4g}"

    return [
        {
            "start": f"{s['start']}{'*' if s is starts[0] else ''}",
            "held out": cell(s["held_out"]),
            "loss": cell(s["loss"]),
            "epochs": str(s["epochs"]),
            "s": f"{s['seconds']:.1f}",
            "outcome": s["outcome"],
        }
        for s in starts
    ]
