"""The cases of a split, and the commitment that seals their answers.

    FOLDER/commitment.json      SHA-256 of every file of every case, of its answer, and of the secret of a sealed split
    FOLDER/vocabulary.json      the names that are scored, by plant
    FOLDER/cases/ID/            what a tool may read: rig.toml, identify.csv, holdout.csv, the plant's file
    FOLDER/sealed/ID/           kept back: sealed.json (the answer), third.csv (the recording that nobody has seen)

The seeds of "development" are public. Those of "sealed" come from a secret (HMAC), of which commitment.json has the
hash: who makes the split publishes the folder without `sealed`, collects answers, and then publishes the secret, from
which everybody can make the same folder again.
"""

import hashlib
import hmac
import json
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from greygate.contents import contents
from greygate.errors import InputError
from greygate.files import replaceable, replacing_folder
from greygate.mismatch.concealed.conceal import BOTH, EVERY_RIG, conceal
from greygate.mismatch.concealed.stress import CONDITIONS
from greygate.progress import Progress, silent
from greygate.reading import anything, line, maybe, named, read_json, table

from .vocabulary import vocabulary

KIND = "bench-concealed"
SCHEMA = "concealed-bench/1"
COMMITMENT = "commitment.json"
SPLITS = ("development", "sealed")
KINDS = ("clean", "one", "foreign", "one", "two", "clean", "one", BOTH, "parameter", "foreign")  # in this order
PLANTS = tuple(EVERY_RIG)
FIRST_SEED = 500_000  # of the development split: other seeds than those of benchmarks/concealed.py
SECRET = 16  # characters of a secret, at least
HEX = 16
DIGITS = 10  # of the name of a sealed case
HIDDEN = ("sealed.json", "third.csv")
SEALS = {"schema": line, "split": line, "secret_sha256": maybe(line), "cases": named(anything)}


@dataclass(frozen=True)
class Case:
    """One draw: its name says nothing of what it conceals."""

    name: str
    plant: str
    kind: str
    condition: str
    seed: int


def plan(cases: int, secret: str = "", plants: Sequence[str] = (), conditions: Sequence[str] = ()) -> list[Case]:
    """The first `cases` of a split, the sealed one if a secret is given: conditions, kinds and plants in turn.

    plants, conditions: those from which the cases are drawn; all if empty.
    Raises InputError for an unknown plant or condition, for no case, and for a secret that is easily guessed.
    """
    for given, known, what in ((plants, PLANTS, "plant"), (conditions, tuple(CONDITIONS), "condition")):
        if unknown := [name for name in given if name not in known]:
            raise InputError(f"bench-concealed: no {what} {unknown[0]!r}; there are {', '.join(known)}")
    if cases < 1:
        raise InputError(f"bench-concealed: {cases} cases; make at least one")
    if secret and len(secret) < SECRET:
        raise InputError(f"bench-concealed: the secret has {len(secret)} characters; give {SECRET} or more")
    plants, conditions = plants or PLANTS, conditions or tuple(CONDITIONS)
    found = [_case(number, secret, plants, conditions) for number in range(cases)]
    return sorted(found, key=lambda case: case.name)


def _case(number: int, secret: str, plants: Sequence[str], conditions: Sequence[str]) -> Case:
    turn, condition = divmod(number, len(conditions))
    again = number // (len(conditions) * len(KINDS))  # every kind under every condition once; then with other plants
    plant, kind = plants[(number + again) % len(plants)], KINDS[turn % len(KINDS)]
    if not secret:
        return Case(f"d{number:04}", plant, kind, conditions[condition], FIRST_SEED + number)
    digest = hmac.new(secret.encode(), str(number).encode(), hashlib.sha256).hexdigest()
    return Case(f"s{digest[:DIGITS]}", plant, kind, conditions[condition], int(digest[DIGITS : DIGITS + HEX], HEX))


def make(
    out: Path,
    cases: int,
    secret: str = "",
    plants: Sequence[str] = (),
    conditions: Sequence[str] = (),
    progress: Progress = silent,
) -> dict:
    """Write a split to the folder `out`, and return its commitment. The same arguments give the same bytes.

    Raises InputError as `plan`, and for an `out` that is not a folder of this kind.
    """
    planned = plan(cases, secret, plants, conditions)
    replaceable(out, KIND)
    seals: dict[str, dict[str, str]] = {}
    with replacing_folder(out, KIND) as folder, tempfile.TemporaryDirectory() as scratch:
        for number, case in enumerate(planned):
            progress(f"{number} of {cases} cases")
            drawn = conceal(case.plant, case.seed, Path(scratch) / case.name, kind=case.kind, under=case.condition)
            seals[case.name] = dict(_deal(drawn, folder, case.name))
        commitment = {
            "schema": SCHEMA,
            "split": SPLITS[bool(secret)],
            "secret_sha256": hashlib.sha256(secret.encode()).hexdigest() if secret else None,
            "cases": seals,
        }
        (folder / COMMITMENT).write_text(json.dumps(commitment, indent=1) + "\n")
        (folder / "vocabulary.json").write_text(json.dumps(vocabulary(), indent=1) + "\n")
    return commitment


def _deal(drawn: Path, folder: Path, name: str) -> Iterator[tuple[str, str]]:
    """Deal the files of a case that was drawn to what may be read and what is kept back; yields (file, SHA-256)."""
    for part in ("cases", "sealed"):
        (folder / part / name).mkdir(parents=True)
    for path in sorted(drawn.iterdir()):
        if path.suffix not in (".toml", ".csv", ".json") or path.name == "manifest.json":
            continue
        part = "sealed" if path.name in HIDDEN else "cases"
        shutil.copyfile(path, folder / part / name / path.name)
        yield f"{part}/{name}/{path.name}", hashlib.sha256(path.read_bytes()).hexdigest()


def committed(bench: Path, sealed: bool) -> dict[str, Path]:
    """The cases of a split: name -> folder, after comparing every file with the commitment.

    sealed: those kept back, for scoring. Raises InputError for a folder that `make` did not write, for a file that is
    missing or was changed, and for a split whose answers are not there.
    """
    bench = Path(bench)
    found = table(read_json(bench / COMMITMENT, "make the folder with greygate dev bench-concealed make"),
                  f"{bench / COMMITMENT}:", SEALS)  # fmt: skip
    part = "sealed" if sealed else "cases"
    if sealed and not (bench / part).is_dir():
        raise InputError(f"{bench}: holds no answers; put the folder `sealed` there that its maker published")
    for seals in found["cases"].values():
        for file, seal in seals.items():
            if file.startswith(f"{part}/") and hashlib.sha256(contents(bench / file)).hexdigest() != seal:
                raise InputError(f"{bench / file}: is not what was committed to (SHA-256 differs); fetch it again")
    return {name: bench / part / name for name in found["cases"]}
