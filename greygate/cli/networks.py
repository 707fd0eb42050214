"""Commands on float networks: train, validate, identify, build-snn."""

import json
from pathlib import Path
from typing import Annotated

import typer

from greygate.cli import options, words
from greygate.cli.backends import Backend, OnBackend, Scheduler, joblib_on
from greygate.cli.terminal import Json, finite, following, give, recordings, say
from greygate.errors import InputError

Trained = Annotated[
    str,
    typer.Argument(
        metavar="NETWORK", help="A name of the catalogue, `list`, or NAME.toml.", autocompletion=words.catalogued
    ),
]
RIVALS = ("nominal", "corrected", "linear")  # of a structured network
OWN_TRAINING = (  # options of a user's network
    *("tail", "narx", "epochs", "decay", "settle", "shooting", "seconds"),
    *("seeds", "jobs", "offset", "gain", "html"),
)


def train(
    context: typer.Context,
    name: Trained,
    record: words.Recordings = [],
    held: Annotated[list[str], words.HELD] = [],
    tail: Annotated[
        float, typer.Option(callback=options.SHARE, help="Share at the end of each record that chooses the epoch.")
    ] = 0.0,
    narx: Annotated[bool, typer.Option(help="Train the one-step prediction first.")] = True,
    epochs: Annotated[int, typer.Option(callback=options.COUNT, help="Most epochs of training in free run.")] = 200,
    decay: Annotated[float, typer.Option(callback=options.DECAY, help="Weight decay D of the loss.")] = 0.0,
    settle: Annotated[str, words.SETTLE] = "0",
    shooting: Annotated[
        int | None, typer.Option(callback=options.COUNT, help="Multiple shooting, in windows of N samples.")
    ] = None,
    offset: Annotated[
        list[str], typer.Option(metavar="OUTPUT", help="Its sensor has another offset in each recording but the first.")
    ] = [],
    gain: Annotated[
        list[str], typer.Option(metavar="OUTPUT", help="Its sensor has another gain in each recording but the first.")
    ] = [],
    seeds: Annotated[
        int, typer.Option(callback=options.STARTS, help="Starts: the file's weights, and others that are drawn.")
    ] = 1,
    jobs: words.Jobs = 2,
    seconds: Annotated[float, words.SECONDS] = float("inf"),
    out: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Folder for NAME.toml, .safetensors, .json.")
    ] = None,
    html: Annotated[
        Path | None, typer.Option(metavar="FILE.html", help="HTML page: curves, weights, poles, residuals.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Train a network by Levenberg-Marquardt.

    One of the catalogue is trained from scratch on its own records, NAME.toml on your recordings. If training your own
    network was interrupted, it resumes from OUT/NAME.checkpoint. Exit code 1 if its free run diverges.
    """
    from greygate.machines.catalog import CATALOG

    if name == "list":
        if record:
            raise InputError(f"list: means nothing with {record[0]}; leave it out")
        titles = {n: e.title for n, e in CATALOG.items()}
        give("catalogue", titles, as_json, [f"{n:20} {title}" for n, title in titles.items()])
    elif name not in CATALOG and (record or name.endswith(".toml")):
        how: dict = {"narx": narx, "tail": tail, "epochs": epochs, "decay": decay, "shooting": shooting}
        how |= {"seconds": seconds, "seeds": seeds, "jobs": jobs, "offset": offset, "gain": gain, "html": html}
        _train_own(name, record, held, settle, how, out, as_json)
    else:
        if record or held:
            raise InputError(f"{name} is trained on its own records; give recordings only with a NAME.toml file")
        sources = {n: context.get_parameter_source(n) for n in OWN_TRAINING}
        if given := [f"--{n}" for n, s in sources.items() if s is not None and s.name == "COMMANDLINE"]:
            raise InputError(f"{name} is trained with its own options; give {', '.join(given)} with a NAME.toml file")
        _train_stored(name, out, as_json)


def _train_stored(name: str, out: Path | None, as_json: bool) -> None:
    """Train a network of the catalogue."""
    from greygate.machines.catalog import entry

    chosen = entry(name)
    if not out:
        raise InputError("--out is missing; give the folder to write the trained network to, such as --out .")
    if not out.is_dir():
        raise InputError(f"{out}: no such folder; make it")
    with following(f"training {name}") as progress:
        network, figures = chosen.train(progress)
    chosen.save(network, figures, out)
    give("catalogue-training", figures, as_json, [json.dumps(figures, indent=1), f"written to {out / name}.toml"])


def _train_own(
    network: str, record: list[str], held: list[str], settle: str, how: dict, out: Path | None, as_json: bool
) -> None:
    """Train a user's network."""
    from dataclasses import replace

    from greygate.identify.training import table, train_records
    from greygate.machines.source import Source
    from greygate.pages.summary import aligned
    from greygate.pages.training import page

    if not out:
        raise InputError("--out is missing; give the folder to write the trained network to")
    how |= {"settle": words.settled(settle), "page": page}
    source, others = Source(network, recordings(record)), recordings(held)
    with following(f"training {Path(network).stem}") as progress:
        records, judges = source.apart(others)
        start = replace(source.network(), dt=source.period)
        trained = train_records(start, records, judges, out, progress=progress, **how)
    for remark in trained["remarks"]:
        say(remark)
    lines = []
    for name, errors in trained["rmse"].items():
        for port, error in errors.items():
            beside = f" (linear {finite(trained['linear'][name][port], '.4g')})" if name in trained["linear"] else ""
            lines.append(f"{name:12} {port:10} RMSE {finite(error, '.4g')}{beside}")
    for name, offsets in trained["offsets"].items():
        lines += [f"{name:12} {port:10} offset {value:.4g}, taken off" for port, value in offsets.items()]
    for name, gains in trained["gains"].items():
        lines += [f"{name:12} {port:10} gain {value:.4g}, divided by" for port, value in gains.items()]
    head = f"{trained['epochs']} epochs. {trained['sentence']}"
    if len(trained["starts"]) > 1:
        lines += [*aligned(table(trained["starts"]), ("start", "outcome")), "* chosen by what was held out, normalised"]
    lines += [f"written to {path}" for path in (trained["out"], how["html"]) if path is not None]
    give("train", trained, as_json, [head, *lines], trained["outcome"] != "diverged")


def validate(
    network: words.Network,
    record: words.Recordings = [],
    html: Annotated[Path, typer.Option(metavar="FILE.html", help="HTML page to write.")] = Path("validation.html"),
    lags: Annotated[
        int, typer.Option(callback=options.COUNT, help="Largest lag of the residual tests, in steps.")
    ] = 25,
    settle: Annotated[str, words.SETTLE] = "0",
    as_json: Json = False,
) -> None:
    """Judge a network in free run and by residual tests.

    The first recording was trained on. Judged are k-step prediction and a long run too, on one HTML page. Exit code 1
    if a free run is unbounded.
    """
    from greygate.machines.source import Source
    from greygate.pages import templates
    from greygate.pages.validation import page
    from greygate.pages.validation.judged import advice, judge, table

    skipped = words.settled(settle)
    if skipped is None:
        raise InputError(f"--settle {settle}: only train and identify find it; give the number that they told")
    source = Source(network, recordings(record), skipped)
    with following(f"validating {network}") as progress:
        judged = judge(source, lags, progress)
        templates.write(page(judged), html)
    if supposed := source.supposed:
        say(supposed)
    told = advice(judged)
    lines = [*table(judged), *told, f"written to {html}"]
    beside = {"imported": found} if (found := source.imported) else {}
    give("validate", judged.figures() | {"advice": told} | beside, as_json, lines, judged.bounded)


def identify(
    record: words.Recordings,
    output: Annotated[str, words.OUTPUT],
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder to write; its name becomes the network's.")],
    input: Annotated[list[str], words.INPUT] = [],
    test: Annotated[list[str], words.TEST] = [],
    sample_time: Annotated[float | None, words.SAMPLE_TIME] = None,
    settle: Annotated[str, words.SETTLE] = words.AUTO,
    seconds: Annotated[float, words.SECONDS] = 120.0,
    jobs: words.Jobs = 2,
    backend: OnBackend = Backend.LOKY,
    scheduler: Scheduler = None,
    html: Annotated[Path | None, typer.Option(metavar="FILE.html", help="HTML page: models, runs, residuals.")] = None,
    as_json: Json = False,
) -> None:
    """Find a network from recordings alone.

    It fits linear models, grows networks from the best, and chooses by held-out blocks; its seconds are those of the
    processor, over all processes. Exit code 1 if no network predicts better than the mean, of what was held out or on a
    test.
    """
    from greygate.identify.files import identify_files, lines
    from greygate.pages.identified import page

    side_by_side = jobs if backend is Backend.LOKY else -1
    with joblib_on(backend, scheduler), following("identifying") as progress:
        found = identify_files(
            recordings(record), recordings(test), input, output, out,
            dt=sample_time, seconds=seconds, jobs=side_by_side, settle=words.settled(settle), html=html,
            page=page, progress=progress,
        )  # fmt: skip
    written = [f"written to {path}" for path in (found["out"], html) if path is not None]
    told = [*lines(found), *written, *(f"next: {n}" for n in found["next"])]
    predicts = found["better_than_mean"] and all(fit is not None and fit > 0 for fit in found["test_fit"].values())
    give("identify", found, as_json, told, predicts)


def build_snn(
    plant: words.Plant,
    record: words.Recordings,
    out: Annotated[
        Path, typer.Option(metavar="FOLDER", help="Folder for NAME.toml, .safetensors, .json and NAME.decisions.txt.")
    ],
    test: Annotated[list[str], words.TEST] = [],
    sensor: Annotated[list[str], words.SENSOR] = [],
    output: Annotated[list[str], words.OUTPUT] = [],
    diagnosis: Annotated[Path | None, words.DIAGNOSIS] = None,
    seconds: Annotated[float, words.SECONDS] = float("inf"),
    as_json: Json = False,
) -> None:
    """Build a structured network from a plant's equations.

    It diagnoses the recordings first, unless --diagnosis tells what they say: an effect that is named becomes its own
    module. The network integrates as exactly as the plant needs; where it cannot, the command says which term is why.
    It says what was decided and why. Without --test the end of each recording judges; without --output every output on
    record that is no sensor's is predicted. Exit code 1 if the plant's own simulation is better on what was kept to
    test on; the network is written then too.
    """
    from greygate.identify.expert.files import build_files

    with following("building") as progress:
        found = build_files(
            plant, recordings(record), recordings(test), sensor, output, seconds, out, progress, diagnosis
        )
    lines = [str(line) for line in found["text"]]
    for name, by_target in found["rms"]["network"].items():
        for port, error in by_target.items():
            others = ", ".join(
                f"{who} {finite(found['rms'][who][name][port], '.4g')}" for who in ("nominal", "corrected", "linear")
            )
            lines.append(f"{name:12} {port:10} RMSE {finite(error, '.4g')} ({others})")
    told = {n: v for n, v in found.items() if n != "text"}
    give("build-snn", told, as_json, [*lines, f"written to {found['out']}", found["next"]], found["better"])
