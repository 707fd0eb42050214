"""The blind benchmark of missing physics: `greygate bench-concealed make`, `run`, `score`."""

import sys
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from greygate.cli import options
from greygate.cli.terminal import Json, following, give, say
from greygate.errors import InputError

if TYPE_CHECKING:
    from greygate.cli.printed import BenchMade, BenchRun

app = typer.Typer(help="Make cases of missing physics, run any tool on them, score it.", no_args_is_help=True)
Bench = Annotated[Path, typer.Argument(metavar="BENCH", help="Folder that `bench-concealed make` wrote.")]
LIMIT = 600.0  # s
BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


def _part(name: str) -> Any:
    """A module of the benchmark, which a checkout of the repository has and an installed greygate has not."""
    if not (BENCHMARKS / "concealed_bench").is_dir():
        raise InputError("bench-concealed: needs a checkout of greygate's repository; pip install -e . in one")
    if "benchmarks" not in sys.modules:
        spec = spec_from_file_location("benchmarks", BENCHMARKS / "__init__.py")
        assert spec is not None, "it is a folder"
        sys.modules["benchmarks"] = module_from_spec(spec)
    return import_module(f"benchmarks.concealed_bench.{name}")


@app.command()
def make(
    out: Annotated[Path, typer.Argument(metavar="BENCH", help="Folder to write; an earlier one is replaced.")],
    cases: Annotated[int, typer.Option(callback=options.COUNT, help="Number of cases.")] = 180,
    secret: Annotated[
        Path | None, typer.Option(help="File with a secret: makes the sealed split that it stands for.")
    ] = None,
    plant: Annotated[list[str], typer.Option(help="Only this plant; may be given several times.")] = [],
    condition: Annotated[list[str], typer.Option(help="Only this condition; may be given several times.")] = [],
    as_json: Json = False,
) -> None:
    """Write the cases of a split, and the commitment that seals their answers."""
    cases_of = _part("make")
    word = ""
    if secret is not None:
        try:
            word = secret.read_text(encoding="utf-8").strip()
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(f"{secret}: cannot be read ({error}); give a text file with the secret") from None
        if not word:
            raise InputError(f"{secret}: is empty; write a secret into it")
    with following("concealing") as progress:
        commitment = cases_of.make(out, cases, word, plant, condition, progress)
    lines = [f"{len(commitment['cases'])} cases ({commitment['split']}) written to {out}"]
    lines += [f"publish {out / cases_of.COMMITMENT}; keep {out / 'sealed'} until the answers are in"] if word else []
    result: BenchMade = {
        "out": str(out),
        "split": commitment["split"],
        "cases": len(commitment["cases"]),
        "secret_sha256": commitment["secret_sha256"],
    }
    give("bench-concealed-make", result, as_json, lines)


@app.command()
def run(
    bench: Bench,
    out: Annotated[Path, typer.Option(help="Folder for the answers; those that it holds are kept.")],
    tool: Annotated[
        str, typer.Option(help="greygate, nominal, calibrated, linear, sparse, gaussian, or a command of your own.")
    ] = "greygate",
    limit: Annotated[float, typer.Option(callback=options.SECONDS, help="Seconds for an explanation.")] = LIMIT,
    cases: Annotated[int | None, typer.Option(callback=options.COUNT, help="Only so many cases.")] = None,
    jobs: Annotated[int, typer.Option(callback=options.JOBS, help="Number of cases at a time.")] = 1,
    as_json: Json = False,
) -> None:
    """Let a tool explain every case, and then predict the recording that it has not seen.

    Exit code 1 if the tool fails in a case: it says where, and goes on.
    """
    with following("explaining") as progress:
        found = _part("run").run(bench, tool, out, limit, cases, jobs, progress)
    failed = {name: facts["error"] for name, facts in found.items() if facts["error"]}
    result: BenchRun = {"out": str(out), "cases": len(found), "errors": failed}
    give(
        "bench-concealed-run",
        result,
        as_json,
        [f"{len(found)} answers in {out}"],
    )
    for name, error in failed.items():
        say(f"greygate: {name}: {error}")
    if failed:
        raise typer.Exit(1)


@app.command()
def score(
    bench: Bench,
    answers: Annotated[list[Path], typer.Argument(metavar="ANSWERS...", help="Folders that `run` wrote, one a tool.")],
    rows: Annotated[Path | None, typer.Option(help="CSV to write: one line a case, of the first tool.")] = None,
    picture: Annotated[Path | None, typer.Option(help="SVG to write: reliability diagram of the first tool.")] = None,
    as_json: Json = False,
) -> None:
    """Open the sealed answers and score: names, false claims, intervals, error removed on unseen data, seconds."""
    from greygate.files import replacing

    tables = _part("tables")
    names = [folder.resolve().name for folder in answers]
    if len(set(names)) < len(names):
        raise InputError(f"{' '.join(names)}: two tools of one name; rename the folder of one")
    scores = {name: _part("score").score(bench, folder) for name, folder in zip(names, answers, strict=True)}
    for path, write in ((rows, tables.write_rows), (picture, _part("diagram").draw)):
        if path is not None:
            with replacing(path) as temporary:
                write(scores[names[0]], temporary)
    found = {name: tables.summary(part) for name, part in scores.items()}
    content = {name: found[name] | {"reliability": tables.reliability(part)} for name, part in scores.items()}
    give("bench-concealed-score", content, as_json, tables.lines(found))
