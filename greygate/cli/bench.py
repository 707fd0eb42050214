"""The blind benchmark of missing physics: `greygate dev bench-concealed make`, `run`, `score`."""

import sys
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from greygate.cli import words
from greygate.cli.terminal import Json, following, give, say
from greygate.errors import InputError

if TYPE_CHECKING:
    from greygate.cli.printed import BenchMade, BenchRun

app = typer.Typer(help="Make cases of missing physics; run and score any tool.", no_args_is_help=True)
Bench = Annotated[Path, typer.Argument(metavar="BENCH", help="Folder that `make` wrote.")]
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
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder to write; an earlier one is replaced.")],
    cases: Annotated[int, words.CASES] = 180,
    secret: Annotated[
        Path | None, typer.Option(metavar="FILE", help="With a secret: makes the sealed split that it stands for.")
    ] = None,
    plant: Annotated[list[str], typer.Option(metavar="NAME", help="Only this plant.")] = [],
    condition: Annotated[list[str], words.CONDITION] = [],
    as_json: Json = False,
) -> None:
    """Write the cases of a split, and what seals their answers."""
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
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder for the answers; those that it holds are kept.")],
    tool: Annotated[
        str, typer.Option(help="greygate, nominal, calibrated, linear, sparse, gaussian, or a command of your own.")
    ] = "greygate",
    seconds: Annotated[float, words.SECONDS] = LIMIT,
    cases: Annotated[int | None, words.CASES] = None,
    jobs: words.Jobs = 1,
    as_json: Json = False,
) -> None:
    """Let a tool explain cases, and predict what it has not seen.

    The time limit is that of an explanation. Exit code 1 if the tool fails in a case: it says where, and goes on.
    """
    with following("explaining") as progress:
        found = _part("run").run(bench, tool, out, seconds, cases, jobs, progress)
    failed = {name: facts["error"] for name, facts in found.items() if facts["error"]}
    result: BenchRun = {"out": str(out), "cases": len(found), "errors": failed}
    give("bench-concealed-run", result, as_json, [f"{len(found)} answers in {out}"])
    for name, error in failed.items():
        say(f"greygate: {name}: {error}")
    if failed:
        raise typer.Exit(1)


@app.command()
def score(
    bench: Bench,
    answers: Annotated[list[Path], typer.Argument(metavar="ANSWERS", help="Folders that `run` wrote, one a tool.")],
    out: Annotated[
        Path | None, typer.Option(metavar="FILE.csv", help="CSV to write: one line a case, of the first tool.")
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE.svg", help="SVG to write: reliability diagram of the first tool.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Open the sealed answers and score those of tools.

    Scored are names, false claims, intervals, the error removed on unseen data, and seconds.
    """
    from greygate.files import replacing

    tables = _part("tables")
    names = [folder.resolve().name for folder in answers]
    if len(set(names)) < len(names):
        raise InputError(f"{' '.join(names)}: two tools of one name; rename the folder of one")
    scores = {name: _part("score").score(bench, folder) for name, folder in zip(names, answers, strict=True)}
    for path, write in ((out, tables.write_rows), (picture, _part("diagram").draw)):
        if path is not None:
            with replacing(path) as temporary:
                write(scores[names[0]], temporary)
    found = {name: tables.summary(part) for name, part in scores.items()}
    content = {name: found[name] | {"reliability": tables.reliability(part)} for name, part in scores.items()}
    give("bench-concealed-score", content, as_json, tables.lines(found))
