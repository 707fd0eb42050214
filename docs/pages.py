"""Writes the figures of the pages from stored results: `python docs/pages.py`; `--check` only says what differs.

What stands between `<!-- begin NAME -->` and `<!-- end -->` on docs/PAGE.md is the block NAME of tables/PAGE.j2, filled
from benchmarks/results/*.json (`results`) and models/trained/*.json (`trained`). A result that says how it was made
(`benchmarks/made.py`) is followed by that: `{{ made(results.valve_cylinder.spread) }}`.
The macros of tables/rows.j2, `table` above all, are known to every template.
"""

import json
import math
import re
import statistics
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import jinja2
import rooms

DOCS = Path(__file__).parent
ROOT = DOCS.parent
PLACE = re.compile(r"(<!-- begin (\w+) -->\n)(.*?)(<!-- end -->)", re.S)


class Stored:
    """The JSON files of a folder: `stored.NAME`."""

    def __init__(self, folder: Path):
        self._folder = folder

    def __getattr__(self, name: str) -> Mapping:
        if not (path := self._folder / f"{name}.json").exists():
            raise AttributeError(f"{path.relative_to(ROOT)} is not there")
        return json.loads(path.read_text(encoding="utf-8"))


def pair(values: Iterable[float], digits: int = 3, between: str = " / ") -> str:
    """Two chambers, as a table shows them."""
    return between.join(f"{value:.{digits}f}" for value in values)


def mpa(values: Iterable[float], digits: int = 3, between: str = " / ") -> str:
    """Two pressures in Pa, as MPa."""
    return pair((value / 1e6 for value in values), digits, between)


def figures(value: float, digits: int = 3) -> str:
    """A number with so many significant figures, and no exponent."""
    return f"{float(f'{value:.{digits}g}'):.{max(digits - 1 - math.floor(math.log10(abs(value))), 0)}f}"


def cell(row: Sequence, column: object, form: str = "%s", scale: float = 1, at: str = "{column}") -> str:
    """One cell of the macro `table`, of a row (title, found, key, format): found at a path; its numbers in a format.

    found may be several, of which each gives a number. A path is keys and places with points between. Text stays as it
    is. Raises KeyError or IndexError where nothing is at the path.
    """
    _, found, key, own = (*row, "", "", "")[:4]
    form = own or form
    if isinstance(column, tuple):
        column, form, scale = (*column, *(form, scale)[len(column) - 1 :])
    path = at.format(column=column, key=key).split(".")
    numbers: list = []
    for place in found if isinstance(found, tuple) and isinstance(found[0], Mapping) else (found,):
        for word in path:
            place = place[word] if isinstance(place, Mapping) else place[int(word)]
        numbers += place.values() if isinstance(place, Mapping) else place if isinstance(place, list) else [place]
    if isinstance(numbers[0], str):
        return numbers[0]
    scaled = tuple(number * scale for number in numbers)
    return figures(*scaled) if form == "figures" else form.format(*scaled) if "{" in form else form % scaled


def made(found: Mapping) -> str:
    """The command that makes a result again, and when it was made."""
    how = found["made"]
    return f"`{how['command']}`, {how['date']}, commit {how['commit']}."


def share(found: Mapping | float | None) -> str:
    """A count of so many, or a number; a dash where the question does not arise."""
    if isinstance(found, Mapping):
        return f"{found['count']} of {found['of']}" if found["of"] else "–"
    return "–" if found is None else f"{found:.3g}"


def median(rows: Iterable[Mapping], key: str) -> float:
    return statistics.median(row[key] for row in rows)


def worst(rows: Iterable[Mapping], key: str) -> float:
    return max(row[key] for row in rows)


def page(path: Path) -> str:
    """The text of a page with its figures as stored. Raises jinja2.UndefinedError where a result is not there."""
    text = path.read_text(encoding="utf-8")
    if not PLACE.search(text):
        return text
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(DOCS / "tables"), undefined=jinja2.StrictUndefined, trim_blocks=True,
        lstrip_blocks=True, autoescape=False,
    )  # fmt: skip
    environment.filters |= {f.__name__: f for f in (pair, mpa, figures, cell)}
    environment.globals |= vars(environment.get_template("rows.j2").module)
    stored = {"results": Stored(ROOT / "benchmarks" / "results"), "trained": Stored(ROOT / "models" / "trained")}
    template = environment.get_template(f"{path.stem.lower()}.j2")
    context = template.new_context({**stored, **{f.__name__: f for f in (made, share, median, worst, rooms.drawn)}})

    def filled(place: re.Match) -> str:
        if place[2] not in template.blocks:
            raise KeyError(f"{template.name} has no block {place[2]!r}, which {path.name} asks for")
        return place[1] + "".join(template.blocks[place[2]](context)).strip() + "\n" + place[4]

    return PLACE.sub(filled, text)


def pages() -> list[Path]:
    return [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.glob("*.md"))]


def main() -> int:
    check = "--check" in sys.argv[1:]
    differing = [path for path in pages() if page(path) != path.read_text(encoding="utf-8")]
    for path in differing:
        print(f"{path.relative_to(ROOT)} {'is not as generated; run make pages' if check else 'written'}")
        if not check:
            path.write_text(page(path), encoding="utf-8")
    return int(check and bool(differing))


if __name__ == "__main__":
    sys.exit(main())
