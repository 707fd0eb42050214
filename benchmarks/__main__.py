"""Benchmarks by name.

    python -m benchmarks                                         what there is, and how long it takes
    python -m benchmarks NAME [arguments] [--results FOLDER]     runs one; NAME --help says more

It runs in the root of the repository, in the environment that `make` sets up. A benchmark is a module of this folder
that says how long it TAKES. Its command line is the signature of its `main`; where it has PARTS (name -> what finds it)
in its place, each part is kept as it comes. Its modules may be imported from `tests` and `docs`, and BLAS has one
thread unless its THREADS are "all". NEEDS are programs and modules that must be there. made.py stamps what is stored.
"""

import argparse
import ast
import importlib
import importlib.util
import inspect
import os
import shutil
import sys
import types
import typing
from collections.abc import Callable, Collection, Mapping
from pathlib import Path

from . import made

TOLD = ("TAKES", "THREADS")


def known() -> dict[str, dict[str, str]]:
    """Benchmark -> first line of its docstring, and what it tells before it is imported."""
    found = {}
    for path in sorted(Path(__file__).parent.glob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        told = {
            node.targets[0].id: ast.literal_eval(node.value)
            for node in tree.body
            if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name) and node.targets[0].id in TOLD
        }
        if "TAKES" in told:
            found[path.stem] = {"about": (ast.get_docstring(tree) or "").splitlines()[0], "THREADS": "one"} | told
    return found


def kept_parts(name: str, parts: Mapping[str, Callable[[], Mapping]]) -> Callable[..., None]:
    """The `main` of a benchmark that has parts."""

    def main(*part: typing.Annotated[str, parts]) -> None:
        for one in part or parts:
            made.keep(name, one, parts[one]())
            print(f"{one}: kept in {made.place(name)}.json", flush=True)

    return main


def one_of(known: Collection[str]) -> Callable[[str], str]:
    """Reads a word that must be one of these."""

    def read(word: str) -> str:
        if word not in known:
            raise argparse.ArgumentTypeError(f"{word!r} is none of {', '.join(known)}")
        return word

    return read


def unpacked(hint: object) -> tuple[Callable, bool, dict]:
    """What reads a word of an argument, whether it takes several words, and its help and choices."""
    notes = getattr(hint, "__metadata__", ())
    base = typing.get_args(hint)[0] if notes else hint
    if isinstance(base, types.UnionType):
        base = next(kind for kind in typing.get_args(base) if kind is not type(None))
    several = bool(typing.get_args(base))
    kind = typing.get_args(base)[0] if several else base
    told, given = " ".join(n for n in notes if isinstance(n, str)), [n for n in notes if not isinstance(n, str)]
    if not given:
        return kind, several, {"help": told}
    return one_of(given[0]), several, {"help": f"{told} ({', '.join(given[0])})".strip(), "metavar": "NAME"}


def called(name: str, main: Callable, about: str | None, words: list[str]) -> object:
    """`main` with the words of a command line."""
    parser = argparse.ArgumentParser(
        f"python -m benchmarks {name}", description=about, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--results", type=Path, default=made.RESULTS, help="folder; benchmarks/results by default")
    hints, signature = typing.get_type_hints(main, include_extras=True), inspect.signature(main).parameters
    for argument, given in signature.items():
        kind, several, told = unpacked(hints[argument])
        if given.kind is given.KEYWORD_ONLY:
            flag = f"--{argument.replace('_', '-')}"
            how = {"action": "store_true"} if kind is bool else {"type": kind, "nargs": "*" if several else None}
            parser.add_argument(flag, default=given.default, **how, **told)
        elif given.kind is given.VAR_POSITIONAL:
            parser.add_argument(argument, nargs="*", type=kind, **told)
        else:
            needed = given.default is given.empty
            parser.add_argument(argument, nargs=None if needed else "?", type=kind, **told,
                                **({} if needed else {"default": given.default}))  # fmt: skip
    values = vars(parser.parse_args(words))
    made.RUN.update(results=values["results"], name=name)
    values["results"].mkdir(parents=True, exist_ok=True)
    ordered = []
    for argument, given in signature.items():
        if given.kind is not given.KEYWORD_ONLY:
            ordered += values[argument] if given.kind is given.VAR_POSITIONAL else [values[argument]]
    return main(*ordered, **{n: values[n] for n, given in signature.items() if given.kind is given.KEYWORD_ONLY})


def missing(needs: Collection[str]) -> list[str]:
    """Programs and modules that are not here."""
    return [need for need in needs if shutil.which(need) is None and importlib.util.find_spec(need) is None]


def run(name: str, words: list[str]) -> object:
    """Run one benchmark; its exit code."""
    benchmarks = known()
    if name not in benchmarks:
        sys.exit(f"{name} is no benchmark; python -m benchmarks lists them")
    if benchmarks[name]["THREADS"] == "one":
        os.environ["OMP_NUM_THREADS"] = "1"  # numpy and torch read it when they are imported
    sys.path[1:1] = [str(made.ROOT / folder) for folder in ("tests", "docs")]
    try:
        module = importlib.import_module(f"benchmarks.{name}")
    except ModuleNotFoundError as error:
        sys.exit(f"{name} needs {error.name}: `make test` installs what benchmarks need")
    main = getattr(module, "main", None) or kept_parts(name, module.PARTS)
    if "--help" not in words and (absent := missing(getattr(module, "NEEDS", ()))):
        sys.exit(f"{name} needs {', '.join(absent)}: install it first")
    return called(name, main, module.__doc__, words)


if __name__ == "__main__":
    if len(sys.argv) > 1 and sys.argv[1] not in ("-h", "--help"):
        sys.exit(run(sys.argv[1], sys.argv[2:]))
    print(*(__doc__ or "").splitlines()[:5], sep="\n")
    for name, told in known().items():
        print(f"{name:20} {told['TAKES']:22} {told['about']}")
